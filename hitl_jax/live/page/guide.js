/** The dialog that leads a person: what to do, a line to agree to, and questions at the end. */

import { keyName } from "./controls.js";

/** NASA-TLX: Hart and Staveland, 1988. */
const QUESTIONS = [
  ["Mental demand", "How mentally demanding was the task?", "Very low", "Very high"],
  ["Physical demand", "How physically demanding was the task?", "Very low", "Very high"],
  ["Temporal demand", "How hurried or rushed was the pace of the task?", "Very low", "Very high"],
  ["Performance", "How successful were you in accomplishing what you were asked to do?", "Perfect", "Failure"],
  ["Effort", "How hard did you have to work to accomplish your level of performance?", "Very low", "Very high"],
  ["Frustration", "How insecure, discouraged, irritated, stressed, and annoyed were you?", "Very low", "Very high"],
];

const element = (id) => document.getElementById(id);

/** Keys that give a slider a value, or confirm the one that it shows. */
const GIVING = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown", "Enter", " "];

/** A slider that has no value until the person gives it one. */
function makeQuestion([name, text, low, high]) {
  const row = element("question").content.cloneNode(true).firstElementChild;
  const slider = row.querySelector("input");
  const [title, asks, left, right] = row.querySelectorAll("[data-text]");
  [title.textContent, asks.textContent, left.textContent, right.textContent] = [name, text, low, high];
  slider.setAttribute("aria-label", `${name}. ${text} From ${low} to ${high}.`);
  slider.setAttribute("aria-valuetext", "not answered");
  const given = () => {
    row.classList.add("given");
    slider.setAttribute("aria-valuetext", slider.value);
    row.dispatchEvent(new Event("given", { bubbles: true }));
  };
  slider.addEventListener("input", given);
  slider.addEventListener("pointerdown", (event) => { if (event.button === 0) given(); });
  slider.addEventListener("keydown", (event) => { if (GIVING.includes(event.key)) given(); });
  return row;
}

export class Guide {
  /**
   * @param {function} send - sends a message to the server.
   * @param {function} changed - called when the dialog opens or closes.
   */
  constructor(send, changed) {
    Object.assign(this, { send, changed, dialog: element("guide"), cards: [], place: 0, stage: "play", connected: false });
    this.questions = QUESTIONS.map(makeQuestion);
    element("questions").append(...this.questions);
    element("questions").addEventListener("given", () => this.showButtons());
    element("agree").addEventListener("change", () => this.showButtons());
    element("guide-back").addEventListener("click", () => this.turn(-1));
    element("guide-next").addEventListener("click", () => this.turn(1));
    this.dialog.addEventListener("cancel", (event) => { if (this.stage !== "play") event.preventDefault(); });
    this.dialog.addEventListener("close", () => this.closed());
    this.dialog.addEventListener("keydown", (event) => this.tryKey(event));
    this.dialog.querySelectorAll("[data-try]").forEach((button) =>
      button.addEventListener("click", () => this.tried(button)));
  }

  get open() { return this.dialog.open; }

  /** Takes what stays the same: which cards there are, and what one agrees to. */
  setUp(hello) {
    const { mode, guide, indicator, intervention } = hello;
    const told = {
      asks: hello.asks, learns: mode !== "test", learned: mode === "test", angle: indicator === "hull_angle",
      other: indicator !== "hull_angle", takeover: intervention === "takeover", reset: intervention === "reset",
      penalty: intervention === "penalty", guided: Boolean(guide),
    };
    this.dialog.querySelectorAll("[data-if]").forEach((part) => { part.hidden = !told[part.dataset.if]; });
    this.help = ["walker", "danger", "safe", "take", "ready"].filter((name) => name !== "take" || told.takeover);
    element("consent-text").textContent = guide?.consent ?? "";
    const minutes = Math.round((guide?.steps ?? 0) / 300) / 10;
    element("guide-length").textContent = minutes <= 1 ? "a minute" : `${minutes} minutes`;
    element("copy").href = `/journal${location.search}`;
  }

  /** Takes what the session waits for; the page that has control is asked. */
  follow(stage, controls) {
    const before = this.stage;
    this.stage = controls ? stage : "play";
    if (this.stage === before) return;
    this.say("");
    if (this.stage !== "play") this.show(this.asked());
    else if (this.open) this.dialog.close();
  }

  /** The cards of what the session waits for. */
  asked() { return { consent: ["consent", ...this.help], questions: ["questions"], end: ["end"] }[this.stage]; }

  showHelp() { if (this.stage === "play" && this.help) this.show(this.help); }

  show(cards) {
    Object.assign(this, { cards, place: 0 });
    this.dialog.querySelectorAll("[data-try]").forEach((button) => this.tried(button, false));
    if (!this.open) this.dialog.showModal();
    this.showCard();
    this.changed();
  }

  /** What the session waits for comes back: browsers let Escape close it when pressed again. */
  closed() {
    if (this.stage !== "play") this.dialog.showModal();
    this.changed();
  }

  get card() { return this.cards[this.place]; }

  showCard() {
    this.dialog.querySelectorAll("[data-card]").forEach((part) => { part.hidden = part.dataset.card !== this.card; });
    const title = this.dialog.querySelector(`[data-card="${this.card}"] h2`);
    this.dialog.setAttribute("aria-label", title.textContent);
    element("guide-place").textContent = this.cards.length > 1 ? `${this.place + 1} of ${this.cards.length}` : "";
    this.showButtons();
    this.dialog.scrollTop = 0;
    title.focus();
  }

  /** Whether there is a connection: without one nothing can be sent. */
  connect(connected) {
    this.connected = connected;
    this.showButtons();
  }

  showButtons() {
    const last = this.place === this.cards.length - 1;
    const next = element("guide-next");
    element("guide-back").hidden = this.place === 0;
    next.hidden = this.card === "end";
    next.textContent = !last ? "Next" : { ready: this.stage === "play" ? "Close" : "Begin", questions: "Send" }[this.card];
    next.disabled = !this.mayTurn();
    const { missing } = this;
    element("missing").textContent = missing ? `Not answered yet: ${missing}` : "";
  }

  get missing() { return this.questions.filter((row) => !row.classList.contains("given")).length; }

  mayTurn() {
    if (this.stage !== "play" && !this.connected) return false;
    if (this.stage === "consent" && !element("agree").checked) return false;
    return this.card !== "questions" || !this.missing;
  }

  turn(by) {
    if (by > 0 && !this.mayTurn()) return;
    if (this.place + by < this.cards.length) {
      this.place += by;
      this.showCard();
    } else this.finish();
  }

  /** The last card's button: what the person was asked for goes to the server. */
  finish() {
    if (this.stage === "play") this.dialog.close();
    else if (this.stage === "consent") this.send({ type: "consent" });
    else if (this.stage === "questions") {
      const answers = this.questions.map((row) => row.querySelector("input").valueAsNumber);
      this.send({ type: "questionnaire", answers });
    }
  }

  /** Says what went wrong, within the dialog: what is behind it cannot be read. */
  say(text) {
    element("guide-alert").hidden = !text;
    element("guide-alert").textContent = text;
  }

  /** A key that a card asks to try; nothing is sent. */
  tryKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const wanted = `[data-card="${this.card}"] [data-try="${CSS.escape(keyName(event))}"]`;
    this.dialog.querySelectorAll(wanted).forEach((button) => this.tried(button));
  }

  tried(button, done = true) {
    const told = button.nextElementSibling;
    told.classList.toggle("done", done);
    told.textContent = done ? "✓ That is it." : "Try it now.";
  }
}
