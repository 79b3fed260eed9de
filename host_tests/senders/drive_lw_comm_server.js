// A user's day with LaserWeb's lw.comm-server, driven by LaserWeb's messages.

'use strict';

const path = require('path');

const day = require('./day');

const { plan, result } = day;
const from = (name) => require(require.resolve(name, { paths: [day.home] }));

async function meet() {
  const socket = await day.call(from('ws'));
  const seen = { state: '', mpos: [], wco: [0, 0, 0], left: 0, sent: false };
  socket.on('data', (line) => { // over telnet it first sends the text 'undefined'
    const text = line.trim();
    const setting = /^\$(\d+)=(\S+)/.exec(text);
    if (setting) result.settings[setting[1]] = setting[2];
    if (text.startsWith('<')) read(text, seen);
    else if (text !== 'undefined') day.note(text.replace(/^(error|ALARM): /, '$1:'));
  });
  socket.on('firmware', ({ version }) => { result.version = version || result.version; });
  socket.on('feedOverride', (percent) => day.noteState('', percent));
  socket.on('qCount', (left) => { seen.left = left; });
  socket.emit('connectTo', day.place ? `telnet,${day.place.hostname}` : `usb,${plan.port},115200`);
  return driver(socket, seen);
}

// LaserWeb reads machine positions from the reports itself; the server passes them on.
function read(report, seen) {
  const field = (name) => (new RegExp(`${name}:([-\\d.,]+)`).exec(report) || [])[1];
  const place = (text) => text.split(',').slice(0, 3).map(Number);
  seen.state = /^<(\w+)/.exec(report)[1];
  seen.mpos = place(field('MPos'));
  if (field('WCO')) seen.wco = place(field('WCO'));
  day.noteState(seen.state);
}

function driver(socket, seen) {
  return {
    state: () => seen.state,
    mpos: () => seen.mpos,
    wpos: () => seen.mpos.map((mm, i) => Number((mm - seen.wco[i]).toFixed(3))),
    home: () => {
      socket.emit('clearAlarm', 2);
      setTimeout(() => socket.emit('home', 'all'), 1000);
    },
    settings: () => socket.emit('runCommand', '$$'),
    jog() {
      socket.emit('jog', 'X,-10,3000');
      socket.emit('jog', 'Y,-20,3000');
    },
    zero: () => socket.emit('setZero', 'all'),
    start: (program) => socket.emit('runJob', program),
    begun: () => true,
    feed: () => socket.emit('feedOverride', 10),
    pause: () => socket.emit('pause'),
    resume: () => socket.emit('resume'),
    done: () => seen.left === 0,
  };
}

day.replace({ 'node-hid': {} }); // for pendants
day.stayLocal();
day.leadTelnet();
process.on('unhandledRejection', day.finish);
const { LWCommServer } = require(path.join(day.home, 'server.js'));
LWCommServer({ ...require(path.join(day.home, 'config.js')), IP: '127.0.0.1', webPort: day.httpPort });
meet()
  .then(day.live)
  .then(() => day.finish())
  .catch(day.finish);
