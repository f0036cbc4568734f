// Sorts the table of topics by a column, and finds rows by words.

import { valueAt } from "./fields.js";

const COLLATOR = new Intl.Collator(undefined, { numeric: true });
const SEARCHED = ["topic", "node", "confirmed.type_name", "confirmed.direction", "allocation.binding", "confirmed.refusal"];

export class Topics {
  /** rows: of the topics, as Fields made them; redraw: fills them again. */
  constructor(section, rows, redraw) {
    this.heads = [...section.querySelectorAll("th[data-sort]")];
    this.input = section.querySelector("#find");
    this.found = section.querySelector("#found");
    this.redraw = redraw;
    this.falls = false;
    this.path = "topic";
    rows.arrange = (topics) => this.#arranged(topics);
    for (const head of this.heads) head.querySelector("button").addEventListener("click", () => this.#sortBy(head.dataset.sort));
    this.input.addEventListener("input", redraw);
    this.#mark();
  }

  /** The topics with all of the words, in order. */
  #arranged(topics) {
    const words = this.input.value.toLowerCase().split(/\s+/).filter(Boolean);
    const isFound = (topic) => {
      const text = SEARCHED.map((path) => valueAt(topic, path) ?? "").join("\n").toLowerCase();
      return words.every((word) => text.includes(word));
    };
    const found = topics.filter(isFound);
    this.found.textContent = words.length > 0 ? `${found.length} of ${topics.length}` : "";
    const sign = this.falls ? -1 : 1;
    const value = (topic) => valueAt(topic, this.path) ?? (this.path === "confirmed.paced_rate_hz" ? Infinity : -Infinity); // unpaced; unknown
    return found.sort((one, other) => sign * compared(value(one), value(other)));
  }

  /** A first click puts the largest numbers on top, or names from a to z; a second reverses them. */
  #sortBy(path) {
    this.falls = path === this.path ? !this.falls : path !== "topic";
    this.path = path;
    this.#mark();
    this.redraw();
  }

  #mark() {
    for (const head of this.heads) {
      if (head.dataset.sort === this.path) head.ariaSort = this.falls ? "descending" : "ascending";
      else head.removeAttribute("aria-sort");
    }
  }
}

function compared(one, other) {
  if (typeof one === "string" && typeof other === "string") return COLLATOR.compare(one, other);
  return one === other ? 0 : one < other ? -1 : 1;
}
