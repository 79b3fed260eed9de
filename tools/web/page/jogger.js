// Jogging: sends the pieces of a motion that lasts as long as something is held.

const norm = (vector) => Math.hypot(...vector);

/** Distance of a point from a segment, and how far along the segment its nearest point is. */
function projected(point, from, vector) {
  const square = vector.reduce((sum, x) => sum + x * x, 0) || 1;
  const share = vector.reduce((sum, x, axis) => sum + x * (point[axis] - from[axis]), 0) / square;
  const part = Math.min(1, Math.max(0, share));
  return [norm(vector.map((x, axis) => point[axis] - from[axis] - part * x)), part * Math.sqrt(square)];
}

/** Move while a direction is held or towards a dragged point; a tap moves one step.
 *
 * While held, each piece is sent before the previous one ends. What is queued never reaches
 * further than the machine's braking distance plus UNASKED_S at its feed, so the machine stops by
 * itself if no more pieces arrive, for example after a tab has crashed.
 * choices(way): { step, feed } in the units of reports. A way has a number per axis: [1, -1] is
 * X plus and Y minus.
 */
class Jogger {
  static HOLD_MS = 300;
  static STEPS_AHEAD = 3;
  static MARGIN_MM = 0.01;
  static PIECE_S = 0.1;
  static LEAD_S = 0.15; // for a timer or an answer that is late
  static REPORT_S = 0.25; // between reports: motion that is not reported yet
  static UNASKED_S = Jogger.PIECE_S + Jogger.LEAD_S + Jogger.REPORT_S;
  #grbl; #choices; #pressed = null; #timer = 0; #jog = null; #cancelling = false; #answered = true;
  #steps = 0; #reported = 0;

  constructor(grbl, choices, say) {
    this.#grbl = grbl;
    this.#choices = choices;
    this.say = say;
    grbl.on("status", () => this.#hear());
    grbl.on("lost", () => this.#clear());
    grbl.on("reset", () => this.#clear());
  }

  press(way) {
    this.abort();
    this.#pressed = { way };
    this.#timer = setTimeout(() => this.#hold(), Jogger.HOLD_MS);
  }

  /** Move towards a place, in mm, machine coordinates; call it again while the place is dragged. */
  follow(place) {
    const target = place.map((mm, axis) => this.#withinTravel(mm, axis));
    if (this.#pressed?.target) {
      this.#pressed.target = target;
      return;
    }
    this.abort();
    this.#pressed = { target };
    this.#hold();
  }

  /** End the motion; after a tap, move one step. */
  release() {
    if (!this.#pressed) return;
    const { way } = this.#pressed, tapped = way && !this.#jog;
    this.abort();
    if (tapped && this.#steps < Jogger.STEPS_AHEAD) this.#step(way);
  }

  async #step(way) {
    const { step } = this.#choices(way);
    this.#steps += 1;
    await this.#grbl.send(this.#line(way.map((sign) => sign * step), way));
    this.#steps -= 1;
  }

  /** Stop a held motion; no step is moved. */
  abort() {
    clearTimeout(this.#timer);
    this.#pressed = null;
    if (this.#jog) this.#cancel();
  }

  #clear() {
    clearTimeout(this.#timer);
    this.#pressed = this.#jog = null;
    this.#cancelling = false;
  }

  #hold() {
    if (!this.#cancelling && this.#grbl.state === "Jog") this.#cancel(); // its end is not the place of now
    if (this.#cancelling) { // the previous motion has not stopped yet
      this.#timer = setTimeout(() => this.#hold(), Jogger.HOLD_MS);
      return;
    }
    const jog = { pressed: this.#pressed, planned: this.#at(), pieces: [], sent: 0, gone: 0, begun: performance.now(), line: "" };
    const { room, axis } = this.#course(jog);
    if (jog.pressed.way && room < Jogger.MARGIN_MM) {
      this.#pressed = null;
      return this.say(t`${AXES[axis]} is at the end of its travel.`);
    }
    this.#jog = jog;
    this.#goOn(jog);
  }

  async #goOn(jog) {
    while (this.#jog === jog) {
      const vector = this.#wanted(jog);
      if (vector && !await this.#sendPiece(jog, vector)) return;
      await new Promise((resolve) => setTimeout(resolve, 1000 * Jogger.PIECE_S));
    }
  }

  /** The direction of the next piece, how far it may go in mm, and the axis that limits it. */
  #course({ pressed: { way, target }, planned }) {
    const vector = way || target.map((mm, axis) => mm - planned[axis]), far = norm(vector);
    const unit = vector.map((mm) => mm / (far || 1));
    if (target) return { unit, room: far, axis: 0 };
    const rooms = unit.map((part, axis) => (part ? this.#room(planned[axis], axis, Math.sign(part)) / Math.abs(part) : Infinity));
    const room = Math.min(...rooms);
    return { unit, room, axis: rooms.indexOf(room) };
  }

  /** The next piece as a vector in mm; null if none is due, or the travel ends. */
  #wanted(jog) {
    const { unit, room } = this.#course(jog), speed = this.#speed(unit);
    const ahead = this.#brake(unit, speed) + speed * (Jogger.PIECE_S + Jogger.LEAD_S);
    const blind = Math.min((performance.now() - Math.max(this.#reported, jog.begun)) / 1000, Jogger.REPORT_S);
    const mm = Math.min(ahead - (jog.sent - jog.gone - speed * blind), room);
    return room > Jogger.MARGIN_MM && mm >= Math.min(speed * Jogger.PIECE_S, room) ? unit.map((part) => part * mm) : null;
  }

  /** Return whether it was accepted. Never are two of them under way, so a cancel ends all. */
  async #sendPiece(jog, vector) {
    const inReports = this.#grbl.inches ? vector.map((mm) => mm / MM_PER_INCH) : vector;
    const quiet = jog.sent > 0;
    jog.line = this.#line(inReports, vector);
    jog.pieces.push({ from: jog.planned, vector, begins: jog.sent });
    jog.planned = jog.planned.map((mm, axis) => mm + (vector[axis] || 0));
    jog.sent += norm(vector);
    this.#answered = false;
    const answer = await this.#grbl.send(jog.line, quiet);
    this.#answered = true;
    if (this.#cancelling) this.#grbl.now(JOG_CANCEL);
    if (answer === "ok") return true;
    if (this.#jog === jog) this.abort();
    if (quiet && answer.startsWith("error:")) this.say(explained(answer));
    return false;
  }

  #line(distances, way) {
    const rounded = distances.map((distance) => Number(distance.toFixed(4)));
    const words = rounded.map((distance, axis) => distance && AXES[axis] + distance).filter(Boolean);
    return `$J=${this.#grbl.inches ? "G20" : "G21"} G91 ${words.join(" ")} F${this.#choices(way).feed}`;
  }

  /** Grbl ignores a cancel that comes before the jog has begun, so it is repeated until Idle. */
  #cancel() {
    this.#grbl.withdraw(this.#jog?.line);
    this.#jog = null;
    this.#cancelling = true;
    this.#grbl.now(JOG_CANCEL);
  }

  #hear() {
    this.#reported = performance.now();
    if (this.#jog) this.#advance(this.#jog);
    if (!this.#cancelling) return;
    if (this.#grbl.state === "Jog") this.#grbl.now(JOG_CANCEL);
    else if (this.#answered) this.#cancelling = false;
  }

  /** Note how far along its pieces the machine is; where they overlap, at the first. */
  #advance(jog) {
    const at = this.#at();
    let nearest = Infinity;
    for (const { from, vector, begins } of jog.pieces) {
      const [far, along] = projected(at, from, vector);
      if (far >= nearest - Jogger.MARGIN_MM) continue;
      nearest = far;
      jog.gone = Math.max(jog.gone, begins + along);
    }
    if (this.#answered && this.#grbl.state === "Idle") jog.gone = jog.sent;
    jog.pieces = jog.pieces.filter(({ vector, begins }) => begins + norm(vector) > jog.gone);
  }

  #at() { return this.#grbl.machine.map((at) => at * (this.#grbl.inches ? MM_PER_INCH : 1)); }

  /** The least of a setting's values per axis, as it limits a motion in that direction. */
  #least(unit, first) {
    return Math.min(...unit.map((part, axis) => (part ? (this.#grbl.setting(first + axis) || Infinity) / Math.abs(part) : Infinity)));
  }

  /** mm/s */
  #speed(unit) {
    const feed = this.#choices(unit).feed * (this.#grbl.inches ? MM_PER_INCH : 1);
    return Math.min(feed, this.#least(unit, 110)) / 60;
  }

  /** The braking distance in mm; 0 for an unknown acceleration, which is slower. */
  #brake(unit, speed) {
    return speed * speed / this.#least(unit, 120) / 2;
  }

  /** [low, high] of an axis with soft limits, in mm; null without. */
  #travel(axis) {
    const grbl = this.#grbl, travel = grbl.setting(130 + axis);
    if (grbl.setting(20) !== 1 || !travel) return null; // 0: it turns for ever
    const positive = grbl.options.includes("Z") && (grbl.setting(23) >> axis) & 1;
    const high = positive ? travel : 0;
    return [high - travel + Jogger.MARGIN_MM, high - Jogger.MARGIN_MM];
  }

  #room(at, axis, sign) {
    const travel = this.#travel(axis);
    return travel ? sign * (travel[sign > 0 ? 1 : 0] - at) : Infinity;
  }

  #withinTravel(mm, axis) {
    const [low, high] = this.#travel(axis) || [-Infinity, Infinity];
    return Math.min(high, Math.max(low, mm));
  }
}
