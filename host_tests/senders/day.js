// A user's day with a sender that is a server, driven through its socket as by its pages.
//
//     node drive_NAME.js FOLDER PLAN_FILE RESULT_FILE HTTP_PORT

'use strict';

const fs = require('fs');
const Module = require('module');
const net = require('net');

const [home, planFile, resultFile, httpPort] = process.argv.slice(2);
const plan = JSON.parse(fs.readFileSync(planFile));
const result = { unparsed: [], errors: [], override: [], states: [], settings: {} };
const patienceMs = 60000;
// Lines of Grbl, as senders show them in their consoles.
const known = /^(ok$|error:|ALARM:|<|\$\d+ ?=|\$N\d=|Grbl|\[[A-Z][A-Z\d.]*:)/i;

const numbers = (place) => ['x', 'y', 'z'].map((axis) => Number(place[axis]));
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
// The machine's address: a path, or a host and a port.
const place = plan.port.startsWith('socket:') ? new URL(plan.port) : null;

function finish(error) {
  if (error) result.failed = String(error.stack || error);
  fs.writeFileSync(resultFile, JSON.stringify(result));
  process.exit(0);
}

// Replace modules that the sender loads but this day does not use.
function replace(modules) {
  const load = Module._load;
  Module._load = function (name, ...rest) {
    return name in modules ? modules[name] : load.call(this, name, ...rest);
  };
}

// Bind the sender's server to this computer only, with its page at the given port.
function stayLocal() {
  const listen = net.Server.prototype.listen;
  net.Server.prototype.listen = function (port, ...rest) {
    const done = rest.find((word) => typeof word === 'function');
    return listen.call(this, { port: Number(port) === Number(httpPort) ? port : 0, host: '127.0.0.1' }, done);
  };
}

// Redirect a sender that only connects to the telnet port to the machine's port.
function leadTelnet() {
  const connect = net.connect;
  net.connect = (port, ...rest) => connect(Number(port) === 23 && place ? place.port : port, ...rest);
}

// The part of socket.io 3 and later that a page needs, over one websocket.
class Socket {
  constructor(WebSocket) {
    this.handlers = {};
    this.wire = new WebSocket(`ws://127.0.0.1:${httpPort}/socket.io/?EIO=4&transport=websocket`);
    this.wire.on('message', (data) => this.take(String(data)));
    this.wire.on('error', (error) => { this.failed = error; });
  }

  take(text) {
    if (text[0] === '0') this.wire.send('40');
    else if (text[0] === '2') this.wire.send('3');
    else if (text.startsWith('40')) this.connected = true;
    else if (text.startsWith('42')) {
      const [name, ...words] = JSON.parse(text.slice(text.indexOf('[')));
      (this.handlers[name] || []).forEach((handler) => handler(...words));
    }
  }

  on(name, handler) { (this.handlers[name] = this.handlers[name] || []).push(handler); }

  emit(...words) { this.wire.send('42' + JSON.stringify(words)); }

  // The same for calls that the server acknowledges.
  ask(...words) { this.wire.send('421' + JSON.stringify(words)); }
}

// Wait until the server listens, and connect.
async function call(WebSocket) {
  let socket = null;
  await until('listening', () => {
    if (!socket || socket.failed) socket = new Socket(WebSocket);
    return socket.connected;
  });
  return socket;
}

async function until(what, condition) {
  const end = Date.now() + patienceMs;
  while (!condition()) {
    if (Date.now() > end) throw new Error(`never ${what}: ${JSON.stringify(result).slice(-500)}`);
    await pause(20);
  }
}

function note(line) {
  if (/^(error|ALARM)/i.test(line)) result.errors.push(line);
  else if (line && !known.test(line)) result.unparsed.push(line);
}

function noteState(state, percent) {
  if (state && result.states[result.states.length - 1] !== state) result.states.push(state);
  if (percent) result.override.push(Number(percent));
}

// sender: state(), mpos(), wpos(), and the user's actions.
async function live(sender) {
  const at = (expected) => sender.state() === 'Idle' && expected.every(
    (mm, i) => Math.abs(mm - sender.mpos()[i]) < 0.005
  );

  await until('greeted', () => ['Alarm', 'Run', 'Idle'].includes(sender.state()));
  if (plan.moving) await until('at rest', () => ['Alarm', 'Idle'].includes(sender.state()));
  result.met = result.states.concat(result.errors);
  result.errors = [];
  sender.home();
  await until('homed', () => at(plan.homed));
  result.homed = sender.mpos();
  if (sender.settings) sender.settings();
  await until('told its settings', () => '132' in result.settings);
  sender.jog();
  await until('jogged', () => at(plan.jogged));
  sender.zero();
  await until('zeroed', () => sender.wpos().every((mm) => mm === 0));
  result.zeroed = sender.wpos();

  await sender.start(plan.program.join('\n') + '\n');
  await until('running', () => sender.state() === 'Run' && sender.begun());
  for (const percent of [110, 120]) {
    sender.feed(percent);
    await until('overridden', () => result.override.includes(percent));
  }
  sender.pause();
  await until('held', () => sender.state() === 'Hold');
  await pause(500);
  result.held = sender.mpos();
  sender.resume();
  await until('resumed', () => sender.state() === 'Run');
  await until('done', () => at(plan.ended) && sender.done());
  result.mpos = sender.mpos();
  result.wpos = sender.wpos();
}

module.exports = {
  call, finish, home, httpPort, leadTelnet, live, note, noteState, numbers, place, plan, replace, result,
  resultFile, stayLocal, until,
};
