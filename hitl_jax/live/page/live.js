/** The page of a session: shows what the server sends, and sends what the person does. */

import { createControls } from "./controls.js";
import { Chart, Gauge, Scene } from "./drawing.js";
import { Guide } from "./guide.js";

const SPEEDS = [1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, null];
const SPEED_NAMES = ["1/8 ×", "1/4 ×", "1/2 ×", "1 ×", "2 ×", "4 ×", "8 ×", "max"];
const WAITS = [0.5, 1, 2, 4];
const MODES = { train: "training", test: "test", watch: "watching" };
const WHO = { machine: "machine", person: "person", human: "simulated human" };
const JOINTS = ["hip1", "knee1", "hip2", "knee2"];

const element = (id) => document.getElementById(id);
const root = document.documentElement;
const state = {
  hello: null, role: "watcher", connected: false, frame: null, drawn: null, taken: false, toldUntil: 0,
  status: { paused: false, why_paused: null, speed: 1, asking: null, danger_held: false },
  wanted: {}, episodes: [], deadline: 0, muted: false, reason: "",
};

/** Writes text, where it is not there already. */
function write(id, text) {
  const place = element(id);
  if (place.textContent !== text) place.textContent = text;
}

/** A number with a true minus sign. */
function decimal(value, digits) {
  return value.toFixed(digits).replace("-", "−");
}

/** Writes a state as text, and as an attribute for its colour and shape. */
function writeState(id, value, text = value) {
  element(id).dataset.state = value;
  write(id, text);
}

// Drawing: at most once for each frame of the screen, and only if there is something new.

let asked = false;
const stale = { charts: true };

/** Asks for a drawing at the screen's next frame. */
function redraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(draw);
}

/** Has the charts drawn again as well. */
function redrawCharts() {
  stale.charts = true;
  redraw();
}

const scene = new Scene(element("scene"), redraw);
const gauge = new Gauge(element("gauge"), redraw);
const charts = [
  new Chart(element("chart-return"), redrawCharts, { name: "return", pick: (row) => row.return, marks: true, least: 40 }),
  new Chart(element("chart-boundary"), redrawCharts, {
    name: "boundary |τ|", pick: (row) => (row.boundary === null ? null : Math.abs(row.boundary)), least: 0.02,
  }),
];

function draw() {
  asked = false;
  if (!state.hello) return;
  if (state.frame) drawFrame(state.frame, state.hello);
  if (stale.charts) charts.forEach((chart, i) => chart.draw(state.episodes, i ? state.hello.unit : ""));
  stale.charts = false;
  if (state.status.asking) drawCountdown();
}

function drawFrame(frame, hello) {
  scene.draw(frame, hello);
  gauge.draw(frame, hello);
  // Without this answer the server pauses, since nobody sees the frames.
  if (frame !== state.drawn) send({ type: "seen", frame: frame.n });
  state.drawn = frame;
  root.dataset.frame = frame.n;
  writeState("control", frame.control, WHO[frame.control]);
  writeState("judgement", frame.danger ? "danger" : "safe");
  writeState("alarm", frame.alarm ? "yes" : "no");
  write("episode", `${frame.episode}`);
  write("step-number", `${frame.step}`);
  write("return", decimal(frame.return, 1));
  write("interventions", `${frame.interventions}`);
  write("steps", `${frame.steps}`);
  write("indicator", `${decimal(frame.c, 2)} ${hello.unit}`);
  write("boundary", frame.tau === null ? "none" : `±${Math.abs(frame.tau).toFixed(3)} ${hello.unit}`);
}

/** The seconds left, counted on between the server's messages unless the clock stands still. */
function drawCountdown() {
  const { asking, paused } = state.status;
  const left = paused ? asking.left : Math.max(0, (state.deadline - performance.now()) / 1000);
  write("request-left", left.toFixed(1));
  element("request-meter").value = left / state.hello.answer_seconds;
  if (!paused) redraw();
}

// Updates from the server.

const listeners = {
  hello(message) {
    state.hello = message;
    Object.assign(state, { frame: null, taken: false, episodes: [] });
    scene.clear();
    document.title = message.title;
    root.dataset.mode = message.mode;
    write("title", message.title);
    write("mode", MODES[message.mode]);
    write("gauge-name", message.indicator.replaceAll("_", " "));
    write("request-default", message.no_answer);
    guide.setUp(message);
    listeners.role(message);
  },
  role({ role }) {
    if (state.role !== role) announce(`You are the ${role} now.`);
    state.role = role;
    write("role", role);
    allow();
  },
  history({ episodes }) {
    state.episodes = episodes;
    episodesChanged();
  },
  episode(row) {
    state.episodes.push(row);
    episodesChanged();
  },
  terrain(message) {
    scene.setTerrain(message);
    redraw();
  },
  frame(frame) {
    const before = state.frame?.control ?? "machine";
    state.frame = frame;
    if (frame.control !== before) announce(`In control: ${WHO[frame.control]}.`);
    // Frames that were on their way when the person took over or let go still show who had control.
    if (performance.now() > state.toldUntil) setTaken(frame.control === "person");
    redraw();
  },
  status(status) {
    const before = state.status;
    keepWanted(status);
    state.status = status;
    if (status.paused !== before.paused) announce(status.paused ? "Paused." : "Running.");
    showStatus(status);
    if (status.why_paused !== before.why_paused) showWhyPaused(status.why_paused);
    showRequest(status.asking, before.asking);
    guide.follow(status.stage, state.role === "controller");
    allow();
  },
  error({ message }) {
    complain(message);
    setTaken(state.frame?.control === "person");
  },
};

function episodesChanged() {
  const last = state.episodes.at(-1);
  write("last-episode", last ? `last ${decimal(last.return, 1)}, ${last.end}, ${last.length} steps` : "");
  redrawCharts();
}

/** Keeps a change that the person just made, where the server sent the status before it. */
function keepWanted(status) {
  Object.entries(state.wanted).forEach(([name, { value, until }]) => {
    if (status[name] === value || performance.now() > until) delete state.wanted[name];
    else status[name] = value;
  });
}

/** Shows a change of pause or speed at once, until the server sends its own value. */
function want(name, value) {
  state.status[name] = value;
  state.wanted[name] = { value, until: performance.now() + 1000 };
}

function showStatus(status) {
  const milliseconds = (value) => `${Math.round(value)} ms`;
  root.dataset.paused = status.paused;
  writeState("running", status.paused ? "paused" : status.asking || status.stage !== "play" ? "waiting" : "running");
  write("pause-text", status.paused ? "Resume" : "Pause");
  write("speed", SPEED_NAMES[SPEEDS.indexOf(status.speed)] ?? `${status.speed} ×`);
  write("rate", status.rate.toFixed(1));
  write("watchers", `${status.watchers}`);
  write("labels", `${status.labels}`);
  write("learner", status.learner);
  const [reaction, median] = [status.reaction_ms, status.median_reaction_ms];
  write("reaction", reaction === null ? "none yet" : `${milliseconds(reaction)}, ${milliseconds(median)}`);
  element("danger").setAttribute("aria-pressed", status.danger_held);
}

/** Shows why the server paused by itself; ends all that the person still holds. */
function showWhyPaused(why) {
  element("why-paused").hidden = !why;
  write("why-paused", why ?? "");
  if (why) controls.forEach((control) => control.endAll());
}

/** Shows that the walker asks, and says so once for each request. */
function showRequest(asking, before) {
  element("request").hidden = !asking;
  if (!asking) return;
  state.deadline = performance.now() + 1000 * asking.left;
  if (asking.frame !== before?.frame) {
    announce("The walker asks: is this dangerous? D for danger, S for safe.", 0);
    if (state.role === "controller") beep();
  }
  redraw();
}

/** Sets whether the person has control; sends their action when it begins. */
function setTaken(taken) {
  if (state.taken === taken) return;
  state.taken = taken;
  sent = "";
  allow();
  tellHands();
}

// What the person does.

const held = new Map(JOINTS.map((joint) => [joint, 0]));
let socket = null;
let sent = "";

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

/** Sends a message about the frame that is on the screen. */
function sendSeen(message) {
  if (state.drawn) send({ ...message, frame: state.drawn.n });
}

/** Sends the action of the keys for hips and knees, where it has changed. */
function tellHands() {
  const action = JOINTS.map((joint) => held.get(joint));
  if (!state.taken || state.role !== "controller" || `${action}` === sent) return;
  sent = `${action}`;
  send({ type: "hands", action });
}

function moveJoint(joint, change) {
  held.set(joint, held.get(joint) + change);
  tellHands();
}

/** Takes or gives back control, and shows it at once, until the server sends its own state. */
function toggleTake() {
  state.toldUntil = performance.now() + 400;
  sendSeen({ type: state.taken ? "let_go" : "take" });
  setTaken(!state.taken);
}

/** Goes to the next speed; the server's answer need not be waited for to go further. */
function changeSpeed(by) {
  const now = SPEEDS.indexOf(state.status.speed);
  const next = Math.min(Math.max((now < 0 ? 3 : now) + by, 0), SPEEDS.length - 1);
  want("speed", SPEEDS[next]);
  write("speed", SPEED_NAMES[next]);
  send({ type: "speed", factor: SPEEDS[next] });
}

function togglePause() {
  want("paused", !state.status.paused);
  announce(state.status.paused ? "Paused." : "Running.");
  send({ type: "pause", on: state.status.paused });
}

function toggleMute() {
  state.muted = !state.muted;
  write("mute-text", state.muted ? "Sound off" : "Sound on");
  element("mute").setAttribute("aria-pressed", state.muted);
}

const jointActions = JOINTS.flatMap((joint) => [["plus", 1], ["minus", -1]].map(([name, sign]) => [
  `${joint}-${name}`, { press: () => moveJoint(joint, sign), release: () => moveJoint(joint, -sign) },
]));
const controls = createControls({
  danger: {
    press: () => sendSeen({ type: "danger", down: true }),
    release: () => { if (state.status.stage === "play") sendSeen({ type: "danger", down: false }); },
  },
  // With a release, if an empty one, it counts when the pointer goes down.
  safe: { press: () => sendSeen({ type: "safe" }), release: () => {} },
  undo: { press: () => send({ type: "undo" }) },
  take: { press: toggleTake },
  assist: {
    press: () => send({ type: "assist", on: true }),
    release: () => { if (state.status.stage === "play") send({ type: "assist", on: false }); },
  },
  pause: { press: togglePause },
  step: { press: () => send({ type: "step" }) },
  slower: { press: () => changeSpeed(-1) },
  faster: { press: () => changeSpeed(1) },
  mute: { press: toggleMute },
  help: { press: showHelp },
  ...Object.fromEntries(jointActions),
});

let stoppedForHelp = false;
const guide = new Guide(send, () => {
  allow();
  if (guide.open || !stoppedForHelp) return;
  stoppedForHelp = false;
  togglePause();
});

/** Shows what to do, while the clock stands. */
function showHelp() {
  if (guide.open) return;
  stoppedForHelp = !state.status.paused && state.role === "controller";
  if (stoppedForHelp) togglePause();
  guide.showHelp();
}

/** Why the person cannot judge, or "" where that is possible. */
function whyNoJudging() {
  if (guide.open) return "Close the pages in front first.";
  if (!state.connected) return "There is no connection.";
  if (state.role !== "controller") return "This window only watches: another one has the controls.";
  return state.hello?.mode === "watch" ? "In this mode nobody judges." : "";
}

/** Why control cannot be taken over, or "". */
function whyNoTaking() {
  const kind = state.hello?.intervention;
  if (whyNoJudging() || kind === "takeover") return whyNoJudging();
  const what = kind === "reset" ? "ends the episode" : "only costs the walker a penalty";
  return `Taking over is off: in this session an intervention ${what}.`;
}

/** Enables the controls that can be used now; the others say why not. */
function allow() {
  const judging = whyNoJudging();
  const taking = whyNoTaking();
  const walking = taking || (state.taken ? "" : "Take over first (T).");
  const clock = state.hello?.mode === "watch" && !guide.open && state.connected && state.role === "controller" ? "" : judging;
  const reasons = { danger: judging, safe: judging, undo: judging, take: taking, assist: walking };
  const pace = clock || (state.hello?.guide ? "This session is played in real time." : "");
  Object.assign(reasons, { pause: clock, slower: pace, faster: pace });
  reasons.help = state.hello?.mode === "watch" || state.role !== "controller" ? "In this window nobody judges." : "";
  reasons.step = pace || (state.status.paused ? "" : "Pause first (Space).");
  jointActions.forEach(([name]) => { reasons[name] = walking; });
  const text = JSON.stringify(reasons);
  if (text === state.reason) return;
  state.reason = text;
  Object.entries(reasons).forEach(([name, reason]) => controls.get(name).enable(!reason, reason));
  write("take-text", state.taken ? "Let go" : "Take over");
  element("take").setAttribute("aria-pressed", state.taken);
  write("hands-note", walking || "You walk: hold a joint's key, or G for the assistant.");
}

// Words and sounds.

let announcing = 0;

/** Says something to screen readers; of quick changes only the last. */
function announce(text, wait = 1000) {
  clearTimeout(announcing);
  announcing = setTimeout(() => write("announce", text), wait);
}

let fading = 0;

/** Shows an error over the scene for some seconds. */
function complain(text, seconds = 6) {
  clearTimeout(fading);
  if (guide.open) guide.say(text);
  element("message").hidden = false;
  write("message", text);
  if (seconds) fading = setTimeout(() => { element("message").hidden = true; }, 1000 * seconds);
}

let audio = null;

/** Browsers allow sound only after a gesture. */
function allowSound() {
  audio ??= new AudioContext();
  if (audio.state === "suspended") audio.resume();
}
["pointerdown", "keydown"].forEach((type) => window.addEventListener(type, allowSound));

function beep() {
  if (state.muted || audio?.state !== "running") return;
  const [tone, volume, now] = [audio.createOscillator(), audio.createGain(), audio.currentTime];
  tone.frequency.value = 660;
  volume.gain.setValueAtTime(0.15, now);
  volume.gain.exponentialRampToValueAtTime(0.001, now + 0.18);
  tone.connect(volume).connect(audio.destination);
  tone.start(now);
  tone.stop(now + 0.2);
}

// The connection.

function showConnection(value, text) {
  state.connected = value === "connected";
  guide.connect(state.connected);
  root.dataset.connection = value;
  writeState("connection", value, text);
  allow();
}

/** Opens the socket; after an accident it is opened again, each time a little later. */
function connect(attempt = 0) {
  const token = new URLSearchParams(location.search).get("token") ?? "";
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  let failures = attempt;
  socket = new WebSocket(`${scheme}://${location.host}/socket?token=${encodeURIComponent(token)}`);
  socket.addEventListener("message", (event) => {
    const message = JSON.parse(event.data);
    if (message.type === "hello") {
      failures = 0;
      element("message").hidden = true;
      guide.say("");
      showConnection("connected", "connected");
    }
    listeners[message.type]?.(message);
  });
  socket.addEventListener("close", (event) => {
    setTaken(false);
    showRequest(null);
    if (state.status.stage === "end") showConnection("closed", "closed");
    else if (event.code === 1008 || event.code >= 4000) refused(event.reason);
    else reconnect(failures);
  });
}

function refused(reason) {
  showConnection("closed", "closed");
  complain(reason || "The server refused this window.", 0);
}

function reconnect(failures) {
  const seconds = WAITS[Math.min(failures, WAITS.length - 1)];
  showConnection("reconnecting", `reconnecting in ${seconds} s`);
  complain(`The connection was lost. Trying again in ${seconds} s.`, 0);
  setTimeout(() => connect(failures + 1), 1000 * seconds);
}

showConnection("connecting", "connecting");
connect();
