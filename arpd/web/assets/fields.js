// Fills the places of page.html with a status document. In the page
// - data-field="path|format" takes a value of the document (the format is text where none is named),
// - data-mark-field="path" is marked with the value, for the stylesheet,
// - data-show="path" is shown only while the value is true and not empty, data-hide="path" only while not,
// - <template data-rows="path"> is repeated for each element of a list; inside, paths start at the element.
// Names and reasons come from the network, so they are only set as text.

const NONE = "–";
const STATES = { app_limited: "not filled" };
const SEVERITIES = { info: "", warning: "Warning:", error: "Error:" };

const isNone = (value) => value === undefined || value === null || value === "";
const text = (value) => (isNone(value) ? NONE : String(value));
const words = (value) => text(value).replaceAll("_", " ");
const named = (names) => (value) => (Object.hasOwn(names, value ?? "") ? names[value] : text(value));
const withUnit = (unit, scale) => (value) => (isNone(value) ? NONE : `${number(value * scale)} ${unit}`);

export function number(value) {
  if (isNone(value)) return NONE;
  const rounded = value * (1 + 1e-12); // halves go up
  const digits = Math.abs(rounded) >= 99.95 ? 0 : Math.abs(rounded) >= 9.995 ? 1 : 2;
  return rounded.toFixed(digits);
}

const TIME = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" });
const DAY = new Intl.DateTimeFormat(undefined, { day: "numeric", month: "short" });

/** Unix time (s) in the browser's zone; with the day where that is not today. */
export function clock(unixTime) {
  const at = new Date(unixTime * 1000);
  const isToday = at.toDateString() === new Date().toDateString();
  return isToday ? TIME.format(at) : `${DAY.format(at)} ${TIME.format(at)}`;
}

/** The same without the day, for an axis, where a day would run into the next time. */
export const second = (unixTime) => TIME.format(new Date(unixTime * 1000));
export const minute = (unixTime) => second(unixTime).slice(0, 5);

export const FORMATS = {
  text: (value) => (value === "" ? "" : text(value)),
  words,
  number,
  count: text,
  pace: (value) => (value === null ? "unpaced" : number(value)),
  period: (value) => (value === 0 ? "none" : number(value === undefined ? value : value * 1e-6)),
  mbit: withUnit("Mbit/s", 8e-6),
  ms: withUnit("ms", 1e3),
  age: withUnit("s", 1),
  percent: withUnit("%", 100),
  mebibytes: withUnit("MiB", 2 ** -20),
  counts: (value) =>
    Object.entries(value ?? {})
      .filter(([, count]) => count)
      .map(([name, count]) => `${words(name)}\u00a0${count}`)
      .join(", "),
  time: (value) => (isNone(value) ? NONE : clock(value)),
  state: named(STATES),
  severity: named(SEVERITIES),
};

export function valueAt(document, path) {
  let value = document;
  for (const key of path.split(".")) {
    value = value !== null && typeof value === "object" && Object.hasOwn(value, key) ? value[key] : undefined;
  }
  return value;
}

const isTrue = (value) => (Array.isArray(value) ? value.length > 0 : Boolean(value));

/** The places below root, found once: only their contents change. */
function places(root, isOwn = () => true) {
  const find = (name) =>
    [root, ...root.querySelectorAll(`[data-${name}]`)].filter((e) => e.hasAttribute(`data-${name}`) && isOwn(e));
  return { field: find("field"), mark: find("mark-field"), show: find("show"), hide: find("hide") };
}

function fill(own, document) {
  for (const element of own.field) {
    const [path, format = "text"] = element.dataset.field.split("|");
    const value = valueAt(document, path);
    const said = FORMATS[format](value);
    if (element.textContent !== said) element.textContent = said;
    if (element.localName === "time") element.dateTime = isNone(value) ? "" : new Date(value * 1000).toISOString();
  }
  for (const element of own.mark) element.dataset.mark = text(valueAt(document, element.dataset.markField));
  for (const element of own.show) element.hidden = !isTrue(valueAt(document, element.dataset.show));
  for (const element of own.hide) element.hidden = isTrue(valueAt(document, element.dataset.hide));
}

/** A list that repeats a row for each element of the document. */
class Rows {
  constructor(template) {
    this.template = template;
    this.parent = template.parentElement;
    this.rows = [];
    this.arrange = template.dataset.order === "newest first" ? (elements) => elements.toReversed() : (elements) => elements;
  }

  fill(document) {
    const elements = this.arrange(valueAt(document, this.template.dataset.rows) ?? []);
    while (this.rows.length > elements.length) this.rows.pop().element.remove();
    while (this.rows.length < elements.length) {
      const element = this.template.content.firstElementChild.cloneNode(true);
      this.parent.append(element);
      this.rows.push({ element, own: places(element) });
    }
    elements.forEach((element, index) => fill(this.rows[index].own, element));
  }
}

/** The whole page. */
export class Fields {
  constructor(root) {
    this.lists = [...root.querySelectorAll("template[data-rows]")].map((template) => new Rows(template));
    this.own = places(root, (element) => !this.lists.some((list) => list.parent.contains(element)));
  }

  fill(document) {
    fill(this.own, document);
    for (const list of this.lists) list.fill(document);
  }

  /** The list of the rows at a path. */
  rowsOf(path) {
    return this.lists.find((list) => list.template.dataset.rows === path);
  }
}
