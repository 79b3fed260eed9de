// A user's day with OpenBuilds CONTROL, without its window.

'use strict';

const path = require('path');

const day = require('./day');

const { plan, result } = day;
const from = (name) => require(require.resolve(name, { paths: [day.home] }));

async function meet() {
  const socket = await day.call(from('ws'));
  const seen = { status: null, finished: 0 };
  socket.on('status', (status) => {
    seen.status = status;
    if (status.comms.interfaces.activePort) {
      day.noteState(state(seen), status.machine.overrides.feedOverride);
    }
    result.version = status.machine.firmware.version || result.version;
  });
  socket.on('data', ({ command, response }) => {
    if (command === 'connect' || command.startsWith('[')) return; // its own messages
    const setting = /^\$(\d+)=(\S+)/.exec(response);
    if (setting) result.settings[setting[1]] = setting[2];
    day.note(response);
  });
  socket.on('jobComplete', () => { seen.finished += 1; });
  socket.emit('connectTo', day.place
    ? { type: 'telnet', ip: day.place.hostname }
    : { type: 'usb', port: plan.port, baud: 115200 });
  return driver(socket, seen);
}

// Its own words ("Running" and others) replace the machine's state until the next report.
const state = (seen) => {
  const word = (seen.status ? seen.status.comms.runStatus : '').split(':')[0];
  return ['Idle', 'Run', 'Hold', 'Jog', 'Home', 'Alarm'].includes(word) ? word : '';
};

function driver(socket, seen) {
  const places = () => seen.status.machine.position;
  const work = () => day.numbers(places().work);
  return {
    state: () => state(seen),
    mpos: () => day.numbers(places().offset).map((mm, i) => Number((mm + work()[i]).toFixed(3))),
    wpos: work,
    home: () => {
      socket.emit('clearAlarm', 2);
      setTimeout(() => socket.emit('runCommand', '$H'), 1000);
    },
    settings: () => socket.emit('runCommand', '$$\n$I\n$G'),
    jog: () => socket.emit('jogXY', { x: -10, y: -20, feed: 3000 }),
    zero: () => socket.emit('setZero', 'all'),
    start(data) {
      seen.finished = 0;
      socket.emit('runJob', { isJob: true, data });
    },
    begun: () => true,
    feed: (percent) => socket.emit('feedOverride', percent),
    pause: () => socket.emit('pause'),
    // A hold report that was already sent when it resumes makes it hold again: press twice.
    resume() {
      socket.emit('resume');
      setTimeout(() => { if (state(seen) === 'Hold') this.resume(); }, 1000);
    },
    done: () => seen.finished > 0,
  };
}

// Windows; the search for machines in the network.
const nothing = () => {};
const electron = { app: { setAppUserModelId: nothing, commandLine: { appendSwitch: nothing } } };
day.replace({ electron, evilscan: class {} });
day.stayLocal();
day.leadTelnet();
process.env.WEB_PORT = day.httpPort;
process.on('unhandledRejection', day.finish);
require(path.join(day.home, 'index.js'));
meet()
  .then(day.live)
  .then(() => day.finish())
  .catch(day.finish);
