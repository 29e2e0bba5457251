/** Buttons and keys of the same controls. A hold also ends when the window loses its focus. */

const KEYS_OF_BUTTONS = ["Enter", " "];
/** How long a press without an end lasts, as from a screen reader [ms]. */
const TAP = 200;

/** The name of a key as in `data-keys`: the letter on it, or its code where that is not Latin. */
export function keyName(event) {
  if (event.key === " ") return "Space";
  if (event.key.length > 1) return event.key;
  const latin = event.key.charCodeAt(0) < 128;
  return latin ? event.key.toLowerCase() : event.code.replace(/^Key/, "").toLowerCase();
}

/** What holds a control while this key is down: the key itself, since Shift changes its name. */
function keySource(event) { return `key ${event.code || event.key}`; }

/** One control with its buttons. It is pressed while at least one source (key, pointer) holds it. */
class Control {
  constructor(name, { press, release }) {
    Object.assign(this, { name, press, release, sources: new Set(), enabled: true });
    this.buttons = [...document.querySelectorAll(`[data-control="${name}"]`)];
    this.keys = this.buttons.flatMap((button) => button.dataset.keys?.split(" ") ?? []);
    this.buttons.forEach((button) => this.listen(button));
  }

  begin(source) {
    if (!this.enabled || this.sources.has(source)) return;
    this.sources.add(source);
    if (this.release && this.sources.size > 1) return;
    this.mark(true);
    this.press();
  }

  end(source) {
    if (!this.sources.delete(source) || this.sources.size) return;
    this.mark(false);
    this.release?.();
  }

  endAll() { [...this.sources].forEach((source) => this.end(source)); }

  mark(held) { this.buttons.forEach((button) => button.classList.toggle("held", held)); }

  /** Enables it, or disables it with the reason as its title. */
  enable(enabled, reason) {
    if (!enabled) this.endAll();
    this.enabled = enabled;
    this.buttons.forEach((button) => {
      button.disabled = !enabled;
      button.title = enabled ? "" : reason;
    });
  }

  listen(button) {
    if (this.release) button.dataset.hold = "";
    if (this.keys.length) button.setAttribute("aria-keyshortcuts", this.keys[0]);
    // A click must not move the focus, or the space bar would press this button from then on.
    button.addEventListener("mousedown", (event) => event.preventDefault());
    button.addEventListener("contextmenu", (event) => event.preventDefault());
    button.addEventListener("pointerdown", (event) => this.grab(button, event));
    ["pointerup", "pointercancel", "lostpointercapture"].forEach((type) =>
      button.addEventListener(type, (event) => this.end(`pointer ${event.pointerId}`)));
    button.addEventListener("keydown", (event) => {
      if (!KEYS_OF_BUTTONS.includes(event.key)) return;
      event.preventDefault();
      if (!event.repeat) this.begin(`button ${event.key}`);
    });
    button.addEventListener("keyup", (event) => {
      if (!KEYS_OF_BUTTONS.includes(event.key)) return;
      event.preventDefault();
    });
    button.addEventListener("click", (event) => { if (!this.release || event.detail === 0) this.tap(); });
  }

  /** A hold begins: its pointer is captured, so that its end is told wherever it happens. */
  grab(button, event) {
    if (event.button !== 0 || !this.release) return;
    button.setPointerCapture(event.pointerId);
    this.begin(`pointer ${event.pointerId}`);
  }

  /** A click; for a hold it is one without a pointer, as from a screen reader. */
  tap() {
    clearTimeout(this.tapping);
    this.end("tap");
    this.begin("tap");
    this.tapping = setTimeout(() => this.end("tap"), TAP);
  }
}

/** Makes the controls by name from what each does; gives a map of them. */
export function createControls(actions) {
  const controls = new Map(
    Object.entries(actions).map(([name, action]) => [name, new Control(name, action)]));
  const byKey = new Map([...controls.values()].flatMap((control) => control.keys.map((key) => [key, control])));
  const releaseAll = () => controls.forEach((control) => control.endAll());

  window.addEventListener("keydown", (event) => {
    if (document.querySelector("dialog[open]")) return;
    // With the Meta key a Mac does not tell when others are released.
    if (event.key === "Meta") releaseAll();
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    const control = byKey.get(keyName(event));
    if (!control) return;
    event.preventDefault();
    if (!event.repeat) control.begin(keySource(event));
  });
  window.addEventListener("keyup", (event) => {
    controls.forEach((control) => [keySource(event), `button ${event.key}`].forEach((source) => control.end(source)));
  });
  window.addEventListener("blur", releaseAll);
  document.addEventListener("visibilitychange", () => { if (document.hidden) releaseAll(); });
  return controls;
}
