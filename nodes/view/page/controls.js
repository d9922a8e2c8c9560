// Commands to the node, and the keys.

const element = (id) => document.getElementById(id);
const TOAST = 4000;

let timer;
export function toast(text, isBad = false) {
  const note = element("toast");
  note.textContent = text;
  note.hidden = false;
  note.style.background = isBad ? "var(--bad)" : "";
  clearTimeout(timer);
  timer = setTimeout(() => (note.hidden = true), TOAST);
}

export class Controls {
  /** `page`: the functions of the keys, and `shown(panel)`, the label of a panel's picture. */
  constructor(connection, page) {
    this.connection = connection;
    this.page = page;
    this.control = "none";
    element("stop").onclick = () => this.ask({ op: "stop" });
    element("disarm").onclick = () => this.ask({ op: "arm", armed: false });
    element("release").onclick = () => this.ask({ op: "release" });
    element("reset").onclick = () => this.reset();
    element("arm").onclick = () => element("arm-dialog").showModal();
    element("arm-dialog").onclose = () => {
      const dialog = element("arm-dialog");
      if (dialog.returnValue === "arm") this.ask({ op: "arm", armed: true });
      dialog.returnValue = "";
    };
    for (const panel of ["camera", "predicted"]) {
      element(panel).querySelector(".goal").onclick = () => this.goal(panel);
    }
    element("help-button").onclick = () => element("help").showModal();
    document.addEventListener("keydown", (event) => this.key(event));
  }

  get canSteer() {
    return this.control !== "none";
  }

  permit(control, isBag) {
    this.control = isBag ? "none" : control;
    element("reset").hidden = !this.canSteer;
    for (const button of document.querySelectorAll("button.goal")) button.hidden = !this.canSteer;
    element("about").textContent = isBag
      ? "This page shows a bag."
      : { none: "This page may show data and stop the executor (parameter control: none).", goals: "This page may set goals, pick candidates and reset histories (control: goals).",
          all: "This page may do everything, including arming the executor (control: all)." }[control];
  }

  async ask(command) {
    const { done, text } = await this.connection.ask(command);
    toast(text || (done ? "done" : "it failed"), !done);
  }

  goal(panel) {
    const label = this.page.shown(panel);
    if (!this.canSteer || !label) return;
    const { source, stamp, observed, k } = label;
    this.ask({ op: "goal", source, stamp, observed, k });
  }

  reset() {
    if (this.canSteer) this.ask({ op: "reset" });
  }

  pick(stamp, index) {
    this.ask({ op: "choose", stamp, index });
  }

  key(event) {
    const { target } = event;
    if (event.ctrlKey || event.altKey || event.metaKey || document.querySelector("dialog[open]")) return;
    if (target.matches("select, input:not([type=range])")) return;
    // Space and enter press the focused button; the slider and the time line use the arrow keys themselves.
    if ((event.key === " " || event.key === "Enter") && target.matches("button, summary")) return;
    const { page } = this;
    const keys = {
      " ": () => page.toggle(),
      ArrowLeft: () => page.step(-1),
      ArrowRight: () => page.step(1),
      ",": () => page.step(-1, true),
      ".": () => page.step(1, true),
      ArrowUp: () => page.setK(page.k + 1),
      ArrowDown: () => page.setK(page.k - 1),
      l: () => page.live(),
      d: () => page.gain(),
      a: () => page.toggleArrows(),
      g: () => this.goal("camera"),
      r: () => this.reset(),
      x: () => element("executor").hidden || this.ask({ op: "stop" }),
      "?": () => element("help").showModal(),
    };
    const digit = /^[1-9]$/.test(event.key) ? () => page.setK(Number(event.key)) : null;
    const act = digit ?? keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }
}
