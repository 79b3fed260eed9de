// A user's day with gSender's server, built in FOLDER (`npm run build-dev-server` or similar).

'use strict';

const fs = require('fs');
const path = require('path');

const day = require('./day');

const { plan, result } = day;
const built = ['dist/gsender', 'output'].map((name) => path.join(day.home, name)).find((folder) =>
  fs.existsSync(path.join(folder, 'server-cli.js'))
);
const from = (name) => require(require.resolve(name, { paths: [built] }));
const settingsFile = path.join(path.dirname(day.resultFile), 'cncrc');
const port = day.place ? day.place.hostname : plan.port;

async function meet() {
  const socket = await day.call(from('ws'));
  const seen = { state: {}, sender: {}, sent: new Set() };
  socket.on('controller:state', (kind, state) => {
    result.controller = kind;
    seen.state = state;
    result.axes = (state.axes || {}).axes;
    const status = state.status || {};
    day.noteState(status.activeState, (status.ov || [])[0]);
  });
  socket.on('controller:settings', (kind, settings) => {
    Object.entries(settings.settings || {}).forEach(([name, value]) => {
      result.settings[name.replace('$', '')] = value;
    });
    result.information = settings.info;
    const version = settings.version || {};
    result.version = version.version || settings.version || result.version;
  });
  socket.on('settings:description', (texts) => { result.descriptions = texts; });
  socket.on('settings:alarms', (texts) => { result.alarms = texts; });
  socket.on('settings:group', (texts) => { result.groups = texts; });
  socket.on('sdcard:files', (file) => { result.jobs = (result.jobs || []).concat(file.name); });
  socket.on('sender:status', (status) => { seen.sender = status; });
  socket.on('serialport:write', (line) => seen.sent.add(line.trim()));
  socket.on('serialport:read', (line) => {
    // It also shows a program's lines here, and a lock as its own alarm.
    const its = plan.program.includes(line) || line === 'G4 P0.5' || line.startsWith('ALARM:Homing');
    if (!its) day.note(line);
  });
  socket.ask('open', port, {
    controllerType: 'Grbl', defaultFirmware: 'Grbl', baudrate: 115200,
    network: Boolean(day.place), ethernetPort: day.place ? Number(day.place.port) : 23,
  });
  return driver((...words) => socket.emit('command', port, ...words), seen);
}

function driver(command, seen) {
  const status = () => seen.state.status || {};
  return {
    state: () => status().activeState,
    mpos: () => day.numbers(status().mpos || {}),
    wpos: () => day.numbers(status().wpos || {}),
    home() {
      command('settings:updated', { useAaxisForGrbl: true }); // otherwise A is sent as Y
      command('homing');
    },
    jog: () => command('gcode', plan.jog),
    zero: () => command('gcode', plan.zero),
    async start(program) {
      command('gcode:load', { name: 'day.nc' }, program);
      await day.until('loaded', () => seen.sender.total > 0);
      command('gcode:start');
    },
    begun: () => seen.sender.received > 3,
    feed: (percent) => command('feedOverride', percent),
    pause: () => command('gcode:pause'),
    resume: () => command('gcode:resume'),
    done: () => seen.sender.received === seen.sender.total,
  };
}

// Windows, and writers of other boards' flash.
day.replace({ electron: {}, '@sienci/avrgirl-arduino': class {} });
day.stayLocal();
fs.writeFileSync(settingsFile, JSON.stringify({ checkForUpdates: false }));
process.argv = ['node', 'gsender', '--host', '127.0.0.1', '--port', day.httpPort, '--config', settingsFile];
process.on('unhandledRejection', day.finish);
require(path.join(built, 'server-cli'))()
  .then(meet)
  .then(day.live)
  .then(() => day.finish())
  .catch(day.finish);
