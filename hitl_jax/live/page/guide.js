/** The dialog that leads a person: what to do, a line to agree to, and questions at the end. */

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

/** A slider that has no value until the person gives it one. */
function makeQuestion([name, text, low, high]) {
  const row = element("question").content.cloneNode(true).firstElementChild;
  const slider = row.querySelector("input");
  const [title, asks, left, right] = row.querySelectorAll("[data-text]");
  [title.textContent, asks.textContent, left.textContent, right.textContent] = [name, text, low, high];
  slider.setAttribute("aria-label", `${name}. ${text} From ${low} to ${high}.`);
  const given = () => {
    row.classList.add("given");
    row.dispatchEvent(new Event("given", { bubbles: true }));
  };
  ["input", "pointerdown", "keydown"].forEach((type) => slider.addEventListener(type, given));
  return row;
}

export class Guide {
  /**
   * @param {function} send - sends a message to the server.
   * @param {function} changed - called when the dialog opens or closes.
   */
  constructor(send, changed) {
    Object.assign(this, { send, changed, dialog: element("guide"), cards: [], place: 0, stage: "play" });
    this.questions = QUESTIONS.map(makeQuestion);
    element("questions").append(...this.questions);
    element("questions").addEventListener("given", () => this.showButtons());
    element("agree").addEventListener("change", () => this.showButtons());
    element("guide-back").addEventListener("click", () => this.turn(-1));
    element("guide-next").addEventListener("click", () => this.turn(1));
    this.dialog.addEventListener("cancel", (event) => { if (!this.isHelp) event.preventDefault(); });
    this.dialog.addEventListener("close", () => this.changed());
    this.dialog.addEventListener("keydown", (event) => this.tryKey(event.key.toLowerCase()));
    this.dialog.querySelectorAll("[data-try]").forEach((button) =>
      button.addEventListener("click", () => this.tryKey(button.dataset.try)));
  }

  get open() { return this.dialog.open; }

  /** Whether it is open because the person asked for it, amid a session. */
  get isHelp() { return this.stage === "play"; }

  /** Takes what stays the same: which cards there are, and what one agrees to. */
  setUp(hello) {
    const { mode, guide } = hello;
    this.steps = { consent: guide?.consent, minutes: guide && guide.steps / 3000 };
    const left = { asks: !hello.asks, take: hello.intervention !== "takeover", "no-take": hello.intervention === "takeover" };
    this.dialog.querySelectorAll("[data-if]").forEach((part) => { part.hidden = left[part.dataset.if]; });
    this.help = ["walker", "danger", "safe", "take", "ready"].filter((name) => name !== "take" || !left.take);
    element("consent-text").textContent = guide?.consent ?? "";
    const minutes = this.steps.minutes;
    const shown = minutes < 1 ? "a minute" : `${Math.round(10 * minutes) / 10} minutes`;
    element("guide-length").textContent = guide
      ? `The session takes about ${shown} and ends by itself. Then come six questions.` : "";
    element("learns").textContent = mode === "test"
      ? "This walker has learned already. It asks you for help." : "This walker learns while you watch, from what you say too.";
    element("copy").href = `/journal${location.search}`;
  }

  /** Takes what the session waits for; the page that has control is asked. */
  follow(stage, controls) {
    const before = this.stage;
    this.stage = controls ? stage : "play";
    if (this.stage === before) return;
    const cards = { consent: ["consent", ...this.help], questions: ["questions"], end: ["end"] }[this.stage];
    if (cards) this.show(cards);
    else if (this.open) this.dialog.close();
  }

  showHelp() { this.show(this.help); }

  show(cards) {
    Object.assign(this, { cards, place: 0 });
    this.dialog.querySelectorAll(".done").forEach((one) => one.classList.remove("done"));
    if (!this.open) this.dialog.showModal();
    this.showCard();
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

  showButtons() {
    const last = this.place === this.cards.length - 1;
    const next = element("guide-next");
    element("guide-back").hidden = this.place === 0;
    next.hidden = this.card === "end";
    next.textContent = !last ? "Next" : { ready: this.isHelp ? "Close" : "Begin", questions: "Send" }[this.card];
    const missing = this.questions.filter((row) => !row.classList.contains("given")).length;
    next.disabled = { consent: !element("agree").checked, questions: missing > 0 }[this.card] ?? false;
    element("missing").textContent = missing ? `Not answered yet: ${missing}` : "";
  }

  turn(by) {
    this.place += by;
    if (this.place < this.cards.length) this.showCard();
    else this.finish();
  }

  /** The last card's button: what the person was asked for goes to the server. */
  finish() {
    this.place = this.cards.length - 1;
    if (this.isHelp) this.dialog.close();
    else if (this.stage === "consent") this.send({ type: "consent" });
    else if (this.stage === "questions") {
      const answers = this.questions.map((row) => row.querySelector("input").valueAsNumber);
      this.send({ type: "questionnaire", answers });
    }
  }

  /** A key that a card asks to try; nothing is sent. */
  tryKey(key) {
    this.dialog.querySelectorAll(`[data-card="${this.card}"] [data-try="${key}"]`).forEach((button) => button.classList.add("done"));
  }
}
