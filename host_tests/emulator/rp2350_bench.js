"use strict";
/* A Raspberry Pi Pico 2 in the emulator rp2350js, as a process of pico2.py.

Usage: node rp2350_bench.js FOLDER IMAGE: a built rp2350js, and a UF2. A line of stdin is a command:
a JSON array of its name and arguments; a line of stdout is its answer. The chip runs in `run` only.
*/

const fs = require("fs");
const path = require("path");

const [folder, image] = process.argv.slice(2);
const emulator = require(path.join(folder, "dist", "cjs"));

const QMI = 0x400d0000;
const [PWM_SLICE, PWM_CC] = [0x14, 0x0c];
const OUT_PACKET_US = 1; // how long after a byte has been queued the host sends it
const SET_LINE_CODING = 0x20;
const SET_LINE_STATE = 0x22;
const LINE_CODING = [0x00, 0xc2, 0x01, 0x00, 0, 0, 8]; // 115200 8N1

const mcu = new emulator.RP2350({ coreArch: "arm" });
mcu.logger = { debug() {}, info() {}, warn() {}, error() {} };
const { clock, gpio, usbCtrl: usb } = mcu;
const flashChip = mcu.findPeripheral(QMI).flashChip;
const cdc = new emulator.USBCDC(usb);

let isRunning = false;
const stop = clock.createAlarm(() => (isRunning = false));
// What run() reports.
let edges = [];
let powers = [];
let received = [];
let erased = 0;
let connected = 0;
const writtenInMotion = [];

// The host's end of USB

const toSend = [];
let polled = 0; // bytes that the chip would take
let coding = false;
let isReading = true;
let unread = [];

cdc.onSerialData = (buffer) => received.push(Buffer.from(buffer));
cdc.onDeviceConnected = () => (connected += 1);

const onResetReceived = usb.onResetReceived;
usb.onResetReceived = () => {
  // A device that comes again is asked again what it is.
  Object.assign(cdc, { descriptorsSize: null, descriptors: [], initialized: false });
  Object.assign(cdc, { inEndpoint: -1, outEndpoint: -1 });
  polled = 0;
  unread = [];
  onResetReceived();
};

usb.onEndpointRead = (endpoint, size) => {
  if (endpoint === cdc.outEndpoint) {
    polled = size;
    push();
  } else if (endpoint === 0 && coding && size) {
    coding = false;
    usb.endpointReadDone(0, Uint8Array.from(LINE_CODING));
  }
};

function push() {
  if (polled && toSend.length) {
    usb.endpointReadDone(cdc.outEndpoint, Uint8Array.from(toSend.splice(0, polled)), OUT_PACKET_US);
    polled = 0;
  }
}

const indicateBufferReady = usb.indicateBufferReady.bind(usb);
usb.indicateBufferReady = (endpoint, out) => {
  if (out || isReading || endpoint !== cdc.inEndpoint) indicateBufferReady(endpoint, out);
  else unread.push(endpoint);
};

function request(bRequest, wValue, wLength) {
  const { DataDirection, SetupType, SetupRecipient } = emulator;
  const [dataDirection, type] = [DataDirection.HostToDevice, SetupType.Class];
  const recipient = SetupRecipient.Interface;
  const setup = { dataDirection, type, recipient, bRequest, wValue, wIndex: 0, wLength };
  usb.sendSetupPacket(emulator.createSetupPacket(setup));
}

// Pins and flash

function moving() {
  return mcu.pio.some((pio) => pio.machines.some((each) => each.enabled && !each.waiting));
}

function watchWrite() {
  if (moving()) writtenInMotion.push(clock.nanos / 1000);
}

flashChip.onProgram = watchWrite;
flashChip.onErase = () => {
  watchWrite();
  erased += 1;
  isRunning = false;
};

const LEVELS = { [emulator.GPIOPinState.Low]: 0, [emulator.GPIOPinState.High]: 1 };

function onChange(pin, state, before) {
  // else it has only become an output
  if (state in LEVELS && before in LEVELS) edges.push([clock.nanos, pin, LEVELS[state]]);
}

function watchPower(pin) {
  const { pwm } = mcu;
  const compares = (pin < 32 ? (pin >> 1) & 7 : 8 + ((pin >> 1) & 3)) * PWM_SLICE + PWM_CC;
  const write = pwm.writeUint32.bind(pwm);
  pwm.writeUint32 = (offset, value) => {
    if (offset === compares) powers.push([clock.nanos, (value >>> (16 * (pin & 1))) & 0xffff]);
    write(offset, value);
  };
}

const COMMANDS = {
  run: (nanos) => {
    isRunning = true;
    stop.schedule(Math.max(0, nanos - clock.nanos));
    while (isRunning) mcu.step();
    const said = Buffer.concat(received).toString("base64");
    const waiting = toSend.length;
    const flash = { erased, writtenInMotion };
    const answer = { nanos: clock.nanos, said, waiting, connected, edges, powers, ...flash };
    [edges, powers, received, erased] = [[], [], [], 0];
    return answer;
  },
  send: (data) => {
    toSend.push(...Buffer.from(data, "base64"));
    push();
  },
  line_state: (value) => request(SET_LINE_STATE, value, 0),
  line_coding: () => {
    coding = true;
    request(SET_LINE_CODING, 0, LINE_CODING.length);
  },
  read: (on) => {
    isReading = on;
    if (on) unread.splice(0).forEach((endpoint) => indicateBufferReady(endpoint, false));
  },
  record: (pin) => {
    gpio[pin].addListener((state, before) => onChange(pin, state, before));
  },
  drive: (pin, level) => gpio[pin].setInputValue(level === null ? null : Boolean(level)),
  level: (pin) => (gpio[pin].value in LEVELS ? LEVELS[gpio[pin].value] : null),
  watch_power: watchPower,
  moving,
  erase_takes: (nanos) => {
    flashChip.eraseNanos = nanos;
  },
  read_flash: (at, size) => Buffer.from(mcu.flash.subarray(at, at + size)).toString("base64"),
  write_flash: (at, data) => mcu.flash.set(Buffer.from(data, "base64"), at),
  read_word: (address) => mcu.readUint32(address) >>> 0,
  write_word: (address, value) => mcu.writeUint32(address, value),
  core: () => [mcu.core[0].regs.sp, mcu.core[0].regs.ipsr],
};

const chunk = Buffer.alloc(1 << 16);
let buffered = "";

/* The next line of stdin, or undefined at its end. */
function readLine() {
  for (;;) {
    const end = buffered.indexOf("\n");
    if (end >= 0) {
      const line = buffered.slice(0, end);
      buffered = buffered.slice(end + 1);
      return line;
    }
    const size = fs.readSync(0, chunk, 0, chunk.length, null);
    if (!size) return undefined;
    buffered += chunk.toString("latin1", 0, size);
  }
}

function writeAll(text) {
  for (let data = Buffer.from(text); data.length; data = data.subarray(fs.writeSync(1, data)));
}

mcu.loadFirmware(image, { initChip: false });
mcu.reset();
for (let line = readLine(); line !== undefined; line = readLine()) {
  const [name, ...args] = JSON.parse(line);
  writeAll(JSON.stringify(COMMANDS[name](...args) ?? null) + "\n");
}
