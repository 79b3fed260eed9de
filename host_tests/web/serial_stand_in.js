// navigator.serial whose bytes go over a websocket to a simulator: see bridge.py. ADDRESS is put
// in front. window.portsOpened counts, so that a test sees that a port was opened again.
window.portsOpened = 0;

class PortStandIn extends EventTarget {
  async open() {
    const socket = (this.socket = new WebSocket(`ws://${ADDRESS}/serial`));
    socket.binaryType = "arraybuffer";
    await new Promise((resolve, reject) => {
      socket.onopen = resolve;
      socket.onerror = () => reject(new DOMException("Failed to open serial port.", "NetworkError"));
    });
    window.portsOpened += 1;
    this.readable = new ReadableStream({
      start: (stream) => {
        socket.onmessage = ({ data }) => stream.enqueue(new Uint8Array(data));
        socket.onclose = () => {
          stream.error(new DOMException("The device has been lost.", "NetworkError"));
          this.dispatchEvent(new Event("disconnect"));
        };
      },
      cancel: () => { socket.onclose = null; socket.close(); },
    });
    this.writable = new WritableStream({ write: (bytes) => socket.send(bytes) });
  }

  async close() { this.socket.close(); }
}

Object.defineProperty(navigator, "serial", {
  value: { requestPort: async () => new PortStandIn(), getPorts: async () => [] },
});
