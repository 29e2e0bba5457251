/** Draws the scene with the walker, the gauge of the indicator and the two charts. */

const INK = {
  machine: "#0072b2", danger: "#d55e00", person: "#cc79a7", safe: "#009e73",
  text: "#1d2730", soft: "#56636e", line: "#d5dce2", grid: "#e8ecef", paper: "#ffffff",
  band: "#dcebf5", alarm: "#fbe3d5", sky: "#f5f9fc", ground: "#e3e6df", turf: "#6d7a68",
};
const FONT = "12px system-ui, sans-serif";
const WHO = { machine: "■ machine", person: "● person", human: "◆ simulated human" };

/** A canvas that keeps to its size on the page and to the screen's pixel ratio. */
class Surface {
  constructor(canvas, redraw) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.fit();
    new ResizeObserver(() => { this.fit(); redraw(); }).observe(canvas);
  }

  /** Takes over the size on the page, which is only read when it changes. */
  fit() {
    this.ratio = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = Math.round(this.width * this.ratio);
    this.canvas.height = Math.round(this.height * this.ratio);
  }

  /** An empty canvas, to be drawn on in CSS pixels. */
  begin() {
    if (this.ratio !== window.devicePixelRatio) this.fit();
    const context = this.context;
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    context.font = FONT;
    context.lineJoin = "round";
    return context;
  }
}

/** A line through points in pixels. */
function trace(context, points) {
  context.beginPath();
  points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
}

/** One straight line. */
function segment(context, x1, y1, x2, y2) {
  trace(context, [[x1, y1], [x2, y2]]);
  context.stroke();
}

/** Text whose place is given by its alignment: "left", "center" or "right". */
function write(context, text, x, y, align = "left", colour = INK.soft) {
  context.textAlign = align;
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

/** A number with a true minus sign. */
function signed(value, digits) {
  return (value > 0 ? "+" : "") + value.toFixed(digits).replace("-", "−");
}

/** The walker on its terrain, seen by a camera that follows the hull. */
export class Scene {
  constructor(canvas, redraw) {
    this.surface = new Surface(canvas, redraw);
    this.terrains = new Map();
    this.camera = null;
  }

  /** Remembers an episode's terrain; the last two are kept, as a frame may be older than it. */
  setTerrain({ episode, x, y }) {
    this.terrains.delete(episode);
    this.terrains.set(episode, { x, y });
    while (this.terrains.size > 2) this.terrains.delete(this.terrains.keys().next().value);
  }

  /** Forgets all terrains, as a server that was started again counts its episodes anew. */
  clear() { this.terrains.clear(); }

  draw(frame, hello) {
    const context = this.surface.begin();
    const terrain = this.terrains.get(frame.episode) ?? [...this.terrains.values()].at(-1);
    this.aim(frame.bodies[0], terrain);
    context.fillStyle = INK.sky;
    context.fillRect(0, 0, this.surface.width, this.surface.height);
    if (terrain) this.drawGround(context, terrain, hello.goal);
    this.drawLidar(context, frame, hello.lidar);
    // Leg 2 lies behind the hull and leg 1 before it, so that they can be told apart.
    [3, 4, 0, 1, 2].forEach((i) => this.drawBody(context, frame, hello.shapes[i], i));
    this.drawFeet(context, frame, hello.shapes);
    this.drawTag(context, frame);
  }

  /** Points the camera at the hull: x at once, y slowly, so that the view does not bob. */
  aim([x, y], terrain) {
    const ground = terrain ? heightAt(terrain, x) : y - 2;
    const jumped = !this.camera || Math.abs(this.camera.x - x) > 3;
    this.camera = { x, y: jumped ? ground : this.camera.y + 0.08 * (ground - this.camera.y) };
    this.scale = Math.min(this.surface.height / 5.4, this.surface.width / 9.5);
  }

  /** Metres to pixels. */
  place(x, y) {
    return [
      this.surface.width * 0.36 + (x - this.camera.x) * this.scale,
      this.surface.height - Math.max(40, this.surface.height * 0.16) - (y - this.camera.y) * this.scale,
    ];
  }

  drawGround(context, { x, y }, goal) {
    const { width, height } = this.surface;
    const line = x.map((each, i) => this.place(each, y[i]));
    line.unshift([-9, line[0][1]]);
    line.push([Math.max(width + 9, line.at(-1)[0]), line.at(-1)[1]]);
    trace(context, [[-9, height + 9], ...line, [line.at(-1)[0], height + 9]]);
    context.fillStyle = INK.ground;
    context.fill();
    trace(context, line);
    context.strokeStyle = INK.turf;
    context.lineWidth = 2;
    context.stroke();
    this.drawMetres(context, { x, y });
    this.drawGoal(context, this.place(goal, heightAt({ x, y }, goal)));
  }

  /** A tick for each metre and a number for each fifth one, just below the ground's line. */
  drawMetres(context, terrain) {
    const first = Math.max(0, Math.ceil(this.camera.x - (0.36 * this.surface.width) / this.scale));
    const last = Math.min(terrain.x.at(-1), this.camera.x + (0.64 * this.surface.width) / this.scale);
    context.lineWidth = 1;
    for (let metre = first; metre <= last; metre++) {
      const [x, y] = this.place(metre, heightAt(terrain, metre));
      segment(context, x, y, x, y + (metre % 5 ? 4 : 8));
      if (metre % 5 === 0) write(context, `${metre} m`, x, y + 21, "center");
    }
  }

  drawGoal(context, [x, y]) {
    context.strokeStyle = context.fillStyle = INK.safe;
    context.lineWidth = 2;
    segment(context, x, y, x, y - 60);
    trace(context, [[x, y - 60], [x + 26, y - 51], [x, y - 42]]);
    context.fill();
    write(context, "goal", x + 5, y - 26, "left", INK.text);
  }

  drawLidar(context, frame, lidar) {
    const [x, y] = frame.bodies[0];
    context.lineWidth = 1;
    lidar.angles.forEach((angle, i) => {
      const reach = lidar.range * frame.lidar[i];
      const end = this.place(x + Math.sin(angle) * reach, y - Math.cos(angle) * reach);
      context.strokeStyle = "#0072b24d";
      segment(context, ...this.place(x, y), ...end);
      if (frame.lidar[i] < 1) this.dot(context, end, 2.5, INK.machine);
    });
  }

  dot(context, [x, y], radius, colour) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
  }

  /** Where a point of a body lies, in pixels. */
  point([bodyX, bodyY, angle], [x, y]) {
    const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
    return this.place(bodyX + cos * x - sin * y, bodyY + sin * x + cos * y);
  }

  drawBody(context, frame, shape, i) {
    const body = frame.bodies[i];
    const hull = frame.control === "machine" ? INK.machine : INK.person;
    trace(context, shape.map((point) => this.point(body, point)));
    context.closePath();
    context.fillStyle = i === 0 ? hull : i < 3 ? "#5b6b79" : "#b9c4cd";
    context.fill();
    context.lineWidth = i === 0 && frame.alarm ? 4 : 1.5;
    context.strokeStyle = i === 0 && frame.alarm ? INK.danger : INK.text;
    context.stroke();
    if (i === 1 || i === 3) {
      const [x, y] = this.point(body, [0, 0]);
      context.font = "600 11px system-ui, sans-serif";
      write(context, i === 1 ? "1" : "2", x, y + 4, "center", i === 1 ? "#fff" : INK.text);
      context.font = FONT;
    }
  }

  /** A dot where a shin stands on the ground. */
  drawFeet(context, frame, shapes) {
    frame.feet.forEach((stands, leg) => {
      const shin = 2 + 2 * leg;
      const low = Math.min(...shapes[shin].map(([, y]) => y));
      if (stands) this.dot(context, this.point(frame.bodies[shin], [0, low]), 4, INK.text);
    });
  }

  /** Above the hull, in words: an alarm, and who walks unless it is the machine. */
  drawTag(context, frame) {
    const words = frame.alarm ? ["▲ alarm"] : [];
    if (frame.control !== "machine") words.push(WHO[frame.control]);
    if (!words.length) return;
    const [x, y] = this.place(frame.bodies[0][0], frame.bodies[0][1] + 1.05);
    context.font = "600 13px system-ui, sans-serif";
    write(context, words.join("  "), x, Math.max(y, 18), "center", frame.alarm ? "#8f3f00" : "#853862");
    context.font = FONT;
  }
}

/** The ground's height at x, between the points of the terrain. */
function heightAt({ x, y }, at) {
  const i = Math.min(Math.max(Math.floor((at - x[0]) / (x[1] - x[0])), 0), x.length - 2);
  const part = Math.min(Math.max((at - x[i]) / (x[i + 1] - x[i]), 0), 1);
  return y[i] + part * (y[i + 1] - y[i]);
}

/** The indicator c on its axis, with the band in which no alarm is raised. */
export class Gauge {
  constructor(canvas, redraw) { this.surface = new Surface(canvas, redraw); }

  draw({ c, tau, alarm }, { span, unit, indicator }) {
    const context = this.surface.begin();
    const [left, right, top, bottom] = [26, this.surface.width - 26, 28, 50];
    const place = (value) => left + ((Math.min(Math.max(value, -span), span) + span) / (2 * span)) * (right - left);
    const edge = tau === null ? span : Math.abs(tau);
    this.drawZones(context, [left, place(-edge), place(edge), right], top, bottom, tau);
    this.drawAxis(context, place, bottom, { span, unit, indicator });
    if (edge < span) [-edge, edge].forEach((value) => this.drawEdge(context, place(value), value, top, bottom));
    this.drawPointer(context, place(c), top, bottom, alarm);
  }

  drawZones(context, [left, low, high, right], top, bottom, tau) {
    context.fillStyle = INK.alarm;
    context.fillRect(left, top, right - left, bottom - top);
    context.fillStyle = INK.band;
    context.fillRect(low, top, high - low, bottom - top);
    if (low - left > 50) {
      write(context, "alarm", (left + low) / 2, bottom - 8, "center", "#8f3f00");
      write(context, "alarm", (high + right) / 2, bottom - 8, "center", "#8f3f00");
    }
    const words = tau === null ? "no boundary, no alarm" : "no alarm";
    // Beside the middle, where the pointer is most of the time.
    if (high - low > 150) write(context, words, low + 8, bottom - 8, "left", "#004d7a");
  }

  drawAxis(context, place, bottom, { span, unit, indicator }) {
    context.strokeStyle = INK.soft;
    context.lineWidth = 1;
    [-1, -0.5, 0, 0.5, 1].forEach((part) => {
      const x = place(part * span);
      segment(context, x, bottom, x, bottom + 5);
      write(context, `${signed(part * span, 1)}${part === 1 ? ` ${unit}` : ""}`, x, bottom + 18, "center");
    });
    if (indicator !== "hull_angle" || place(span) - place(-span) < 300) return;
    write(context, "leans forward", place(-0.75 * span), bottom + 18, "center");
    write(context, "leans back", place(0.75 * span), bottom + 18, "center");
  }

  drawEdge(context, x, value, top, bottom) {
    context.strokeStyle = INK.machine;
    context.lineWidth = 3;
    segment(context, x, top - 3, x, bottom + 3);
    write(context, signed(value, 2), x, top - 16, "center", INK.machine);
  }

  drawPointer(context, x, top, bottom, alarm) {
    context.strokeStyle = context.fillStyle = alarm ? INK.danger : INK.text;
    context.lineWidth = 3;
    segment(context, x, top, x, bottom);
    trace(context, [[x, top + 5], [x - 8, top - 11], [x + 8, top - 11]]);
    context.closePath();
    context.fill();
    context.strokeStyle = INK.paper;
    context.lineWidth = 1.5;
    context.stroke();
  }
}

/** Round numbers that divide a range into about `count` parts. */
function ticks(low, high, count) {
  const raw = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((each) => each * power >= raw);
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  const values = Array.from({ length: last - first + 1 }, (_, i) => (first + i) * step);
  return { values, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

/** The mean over up to `window` episodes, the newest at each point. */
function runningMean(points, window) {
  let sum = 0;
  return points.map(({ x, y }, i) => {
    sum += y - (i >= window ? points[i - window].y : 0);
    return { x, y: sum / Math.min(i + 1, window) };
  });
}

/** One value over episodes. */
export class Chart {
  /** `pick` takes the value from an episode; `marks` draws each episode by how it ended. */
  constructor(canvas, redraw, { name, pick, marks = false, least }) {
    this.surface = new Surface(canvas, redraw);
    Object.assign(this, { name, pick, marks, least });
  }

  draw(episodes, unit = "") {
    const context = this.surface.begin();
    const points = episodes
      .map((row) => ({ x: row.episode, y: this.pick(row), end: row.end }))
      .filter(({ y }) => y !== null);
    const title = unit ? `${this.name} [${unit}]` : this.name;
    this.surface.canvas.setAttribute("aria-label", describe(title, points));
    if (!points.length) {
      const words = episodes.length ? "There is no boundary." : "No episode has ended yet.";
      write(context, words, this.surface.width / 2, this.surface.height / 2, "center");
      return;
    }
    const place = this.drawAxes(context, points, title);
    if (this.marks) points.forEach((point) => drawMark(context, place(point), point.end, points.length));
    const line = this.marks ? runningMean(points, 20) : points;
    trace(context, line.map(place));
    context.strokeStyle = INK.machine;
    context.lineWidth = 2;
    context.stroke();
    if (!this.marks) drawMark(context, place(points.at(-1)), "last", 1);
  }

  /** Axes with round numbers; gives the way from values to pixels. */
  drawAxes(context, points, title) {
    const { width, height } = this.surface;
    const [left, right, top, bottom] = [42, width - 12, 22, height - 19];
    const values = points.map(({ y }) => y);
    const middle = (Math.min(...values) + Math.max(...values)) / 2;
    const half = Math.max((Math.max(...values) - Math.min(...values)) * 0.55, this.least / 2);
    const [low, high] = [middle - half, middle + half];
    const [start, stop] = [points[0].x, Math.max(points.at(-1).x, points[0].x + 9)];
    const toX = (x) => left + 8 + ((x - start) / (stop - start)) * (right - left - 8);
    const toY = (y) => bottom - ((y - low) / (high - low)) * (bottom - top);
    context.lineWidth = 1;
    context.strokeStyle = INK.grid;
    const rows = ticks(low, high, Math.max(2, (bottom - top) / 32));
    rows.values.forEach((y) => {
      segment(context, left, toY(y), right, toY(y));
      write(context, y.toFixed(rows.digits).replace("-", "−"), left - 6, toY(y) + 4, "right");
    });
    context.strokeStyle = INK.soft;
    segment(context, left, bottom, right, bottom);
    ticks(start, stop, 5).values.filter(Number.isInteger).forEach((x) => {
      segment(context, toX(x), bottom, toX(x), bottom + 4);
      // The last place is the axis's name.
      if (toX(x) < right - 66) write(context, `${x}`, toX(x), bottom + 16, "center");
    });
    write(context, "episode", right, bottom + 16, "right");
    write(context, title, 4, 13);
    if (this.marks) write(context, "line: mean of 20", right, 13, "right");
    return ({ x, y }) => [toX(x), toY(y)];
  }
}

/** A chart in a sentence, for those who do not see it. */
function describe(title, points) {
  const last = points.at(-1);
  return `${title} over episodes. ` + (last ? `Episode ${last.x}: ${last.y.toFixed(2)}.` : "None yet.");
}

/** An episode as a point: the shape says how it ended, and many of them are drawn smaller. */
function drawMark(context, [x, y], end, count) {
  const size = count > 300 ? 1.5 : count > 80 ? 2.5 : 3.5;
  context.lineWidth = 1.2;
  context.beginPath();
  if (end === "fall") {
    context.strokeStyle = "#7d8992";
    segment(context, x - size, y - size, x + size, y + size);
    segment(context, x - size, y + size, x + size, y - size);
  } else if (end === "time limit") {
    context.strokeStyle = INK.text;
    context.strokeRect(x - size, y - size, 2 * size, 2 * size);
  } else if (end === "human") {
    trace(context, [[x, y - size - 1], [x + size + 1, y], [x, y + size + 1], [x - size - 1, y]]);
    context.fillStyle = INK.person;
    context.fill();
  } else {
    context.arc(x, y, size, 0, 2 * Math.PI);
    context.fillStyle = end === "goal" ? INK.safe : INK.machine;
    context.fill();
  }
}
