// The charts of the last ten minutes, drawn by uPlot. A sentence says the same as each chart.

import { clock, minute, number, second } from "./fields.js";

const MBIT = 8e-6;
const LEAST_SPAN_S = 60; // of an axis that nobody chose
const OUTAGE = "outage";

// The series of each chart: the key in the history's columns, and the same value of a status document.
const CHARTS = [
  {
    id: "rate",
    unit: "Mbit/s",
    scale: MBIT,
    least: 1,
    series: [
      { name: "capacity", key: "capacity_bytes_per_second", of: (s) => s.link.capacity_bytes_per_second, color: "--capacity", width: 2 },
      { name: "budget", key: "budget_bytes_per_second", of: (s) => s.budget_bytes_per_second, color: "--budget", dash: [7, 4], stepped: true },
      { name: "delivered", key: "delivery_rate_bytes_per_second", of: (s) => s.link.delivery_rate_bytes_per_second, color: "--delivered", filled: true },
      { name: "cross traffic", key: "cross_traffic_bytes_per_second", of: (s) => s.link.cross_traffic_bytes_per_second, color: "--cross-traffic", dash: [2, 3] },
    ],
  },
  {
    id: "delay",
    unit: "ms",
    scale: 1e3,
    powers: [10, 1000], // fifty milliseconds and five seconds both show
    notInOutages: true, // there it grows without bound
    series: [{ name: "queue delay", key: "queue_delay_s", of: (s) => s.link.queue_delay_s, color: "--delay", filled: true }],
  },
  {
    id: "allowed",
    unit: "%",
    scale: 100,
    most: 100,
    series: [{ name: "allowed", key: "allowed_ratio", of: (s) => s.allowed_ratio, color: "--allowed", stepped: true, filled: true }],
  },
];
const TOPIC_SERIES = [
  { name: "source", key: "source_rate_hz", of: (t) => t.confirmed.source_rate_hz, color: "--cross-traffic", dash: [2, 3] },
  { name: "allowed", key: "paced_rate_hz", of: (t) => t.confirmed.paced_rate_hz, color: "--budget", dash: [7, 4], stepped: true },
  { name: "sent", key: "published_rate_hz", of: (t) => t.confirmed.published_rate_hz, color: "--delivered", filled: true },
];

/** The last samples in columns, as in the history document; each status document adds one to each column. Those of the topics
 * begin with the page: a new past takes them from the one before. */
class Past {
  constructor(history, status, before) {
    this.spanS = history.span_s;
    this.periodS = history.period_s;
    this.times = history.times;
    this.states = history.states;
    this.columns = new Map(Object.entries(history.link));
    this.topics = new Map();
    this.plans = history.events.filter((event) => event.kind === "plan").map((event) => event.unix_time_s);
    this.generation = undefined;
    if (this.times.length > 0) this.#add(status.topics);
    if (before) this.#recall(before);
  }

  append(status) {
    const now = status.unix_time_s;
    if (this.generation !== undefined && this.generation !== status.plan.generation) this.plans.push(now);
    this.generation = status.plan.generation;
    if (this.times.length > 0 && now < this.times.at(-1) + 0.9 * this.periodS) return;
    this.times.push(now);
    this.states.push(status.link.state);
    for (const { series } of CHARTS) for (const one of series) this.columns.get(one.key).push(one.of(status) ?? null);
    this.#add(status.topics);
    while (this.times[0] < now - this.spanS) this.#forget();
  }

  /** Add the last sample of the topics. */
  #add(topics) {
    const live = new Map(topics.map((topic) => [identity(topic), topic]));
    for (const [name, { topic, node }] of live) if (!this.topics.has(name)) this.topics.set(name, { topic, node, ...this.#absent() });
    for (const [name, topic] of this.topics) {
      for (const one of TOPIC_SERIES) {
        const now = live.get(name);
        topic[one.key].push((now && one.of(now)) ?? null);
      }
    }
  }

  /** Columns of a topic that has not been there before the last time. */
  #absent() {
    return Object.fromEntries(TOPIC_SERIES.map((one) => [one.key, Array(this.times.length - 1).fill(null)]));
  }

  /** Take the rates of topics from an earlier past, at each time the last one then that is not old. */
  #recall({ times, topics }) {
    const known = this.times.map((now) => times.findLastIndex((time) => time <= now && now < time + 2 * this.periodS));
    for (const [name, topic] of this.topics) {
      const earlier = topics.get(name);
      if (earlier) for (const one of TOPIC_SERIES) topic[one.key] = topic[one.key].map((value, at) => value ?? earlier[one.key][known[at]] ?? null);
    }
  }

  #forget() {
    for (const column of [this.times, this.states]) column.shift();
    for (const { series } of CHARTS) for (const one of series) this.columns.get(one.key).shift();
    for (const [name, topic] of this.topics) {
      for (const one of TOPIC_SERIES) topic[one.key].shift();
      if (TOPIC_SERIES.every((one) => topic[one.key].every((value) => value === null))) this.topics.delete(name);
    }
  }
}

const identity = (topic) => `${topic.topic}\n${topic.node}`;

export class Charts {
  constructor(section) {
    this.section = section;
    this.choice = section.querySelector("select");
    this.past = null;
    this.plots = new Map();
    this.choice.addEventListener("change", () => this.draw());
    this.spans = [...section.querySelectorAll("[data-span]")];
    for (const button of this.spans) button.addEventListener("click", () => this.#show(Number(button.dataset.span)));
    this.#show(600);
    new ResizeObserver(() => this.#resize()).observe(section);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#rebuild());
  }

  /** Take a history document whole, and the topics of a status document. */
  load(history, status) {
    this.past = new Past(history, status, this.past);
    this.section.hidden = false;
    this.#offer(status.topics);
    this.draw();
  }

  /** Take what a status document adds to it. */
  append(status) {
    if (this.past === null) return;
    this.past.append(status);
    this.#offer(status.topics);
    this.draw();
  }

  /** Offer the topics to choose from; first the one that the link slows most. */
  #offer(topics) {
    const known = topics.filter((topic) => this.past.topics.has(identity(topic)));
    const names = known.map(identity);
    if (names.join() === [...this.choice.options].map((option) => option.value).join()) return;
    const first = known.reduce((most, topic) => (most && most.kept_ratio <= topic.kept_ratio ? most : topic), null);
    const chosen = names.includes(this.choice.value) ? this.choice.value : first && identity(first);
    const isOne = (topic) => known.filter((other) => other.topic === topic.topic).length === 1;
    const label = (topic) => (isOne(topic) ? topic.topic : `${topic.topic} (${topic.node})`);
    this.choice.replaceChildren(...known.map((topic) => new Option(label(topic), identity(topic))));
    if (chosen) this.choice.value = chosen;
  }

  draw() {
    const { past } = this;
    if (past === null || past.times.length < 2) return;
    for (const chart of CHARTS) {
      const isShown = (index) => !chart.notInOutages || past.states[index] !== OUTAGE;
      const column = (one) => past.columns.get(one.key).map((value, index) => (value !== null && isShown(index) ? value * chart.scale : null));
      this.#draw(chart, chart.series.map(column));
    }
    const topic = past.topics.get(this.choice.value);
    if (!topic) this.#clear("topic");
    else this.#draw({ id: "topic", unit: "Hz", least: 1, series: TOPIC_SERIES }, TOPIC_SERIES.map((one) => topic[one.key]));
  }

  #draw(chart, columns) {
    const data = [this.past.times, ...columns];
    document.getElementById(`text-${chart.id}`).textContent = inWords(chart, this.past.times, columns);
    let plot = this.plots.get(chart.id);
    if (plot) {
      plot.setData(data);
    } else {
      plot = new uPlot(this.#options(chart), data, document.getElementById(`chart-${chart.id}`));
      this.plots.set(chart.id, plot);
    }
    if (plot.cursor.idx === null || plot.cursor.idx === undefined) plot.setLegend({ idx: data[0].length - 1 });
  }

  #clear(id) {
    document.getElementById(`text-${id}`).textContent = "";
    this.plots.get(id)?.destroy();
    this.plots.delete(id);
  }

  #options(chart) {
    const [lowest, highest] = chart.powers ?? [];
    const linear = { range: (_plot, _least, most) => [0, chart.most ?? Math.max(chart.least, (most ?? 0) * 1.08)] };
    const logarithmic = {
      distr: 3,
      range: (_plot, _least, most) => [lowest, Math.max(highest, 10 ** Math.ceil(Math.log10(most || lowest)))],
      clamp: lowest,
    };
    const powers = { splits: (_plot, _axis, least, most) => powersOfTen(least, most), filter: (_plot, splits) => splits };
    const axis = { stroke: color(this.section, "--muted"), font: "12px system-ui", grid: { stroke: color(this.section, "--grid"), width: 1 }, ticks: { show: false } };
    const value = (_plot, number_) => (number_ === null || number_ === undefined ? "–" : `${number(number_)} ${chart.unit}`);
    return {
      ...size(document.getElementById(`chart-${chart.id}`)),
      cursor: {
        sync: { key: "arpd", filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } },
        drag: { x: false, y: false },
        points: { size: 7 },
      },
      scales: {
        x: { range: () => this.#range() },
        y: chart.powers ? logarithmic : linear,
      },
      axes: [
        { ...axis, size: 24, gap: 4, space: 64, values: (_plot, splits) => splits.map(splits[1] - splits[0] < 60 ? second : minute), incrs: [5, 10, 30, 60, 120, 300] },
        { ...axis, size: chart.powers ? 54 : 44, gap: 6, space: 34, ...(chart.powers ? powers : {}) },
      ],
      series: [
        { label: "time", value: (_plot, at) => (at ? clock(at) : "–") },
        ...chart.series.map((one) => ({
          label: one.name,
          stroke: color(this.section, one.color),
          fill: one.filled ? `color-mix(in srgb, ${color(this.section, one.color)} 18%, transparent)` : undefined,
          width: one.width ?? 1.5,
          dash: one.dash,
          paths: one.stepped ? uPlot.paths.stepped({ align: 1 }) : uPlot.paths.linear(),
          points: { show: false },
          fillTo: chart.powers ? lowest : 0,
          value,
        })),
      ],
      hooks: {
        drawClear: [(plot) => this.#mark(plot, color(this.section, "--outage"), color(this.section, "--muted"))],
      },
    };
  }

  /** The times that all charts show: the last ones. */
  #range() {
    const { times } = this.past;
    const last = times.at(-1);
    return [Math.max(last - this.spanS, Math.min(times[0], last - LEAST_SPAN_S)), last];
  }

  #show(spanS) {
    this.spanS = spanS;
    for (const button of this.spans) button.ariaPressed = String(Number(button.dataset.span) === spanS);
    this.draw();
  }

  /** Shade the outages, and mark each new plan. */
  #mark(plot, shade, line) {
    const { ctx, bbox } = plot;
    const x = (at) => Math.min(Math.max(plot.valToPos(at, "x", true), bbox.left), bbox.left + bbox.width);
    const { times, states, plans } = this.past;
    ctx.save();
    ctx.fillStyle = shade;
    times.forEach((at, index) => {
      if (states[index] !== OUTAGE) return;
      const end = times[index + 1] ?? at;
      ctx.fillRect(x(at), bbox.top, Math.max(1, x(end) - x(at)), bbox.height);
    });
    ctx.fillStyle = line;
    const height = 7 * devicePixelRatio;
    for (const at of plans) {
      if (at >= plot.scales.x.min && at <= plot.scales.x.max) ctx.fillRect(x(at) - 1, bbox.top + bbox.height - height, 2, height);
    }
    ctx.restore();
  }

  #resize() {
    for (const [id, plot] of this.plots) plot.setSize(size(document.getElementById(`chart-${id}`)));
  }

  #rebuild() {
    for (const plot of this.plots.values()) plot.destroy();
    this.plots.clear();
    this.draw();
  }
}

/** A colour of the stylesheet, as it is in the light or the dark scheme. */
function color(element, name) {
  element.style.caretColor = `var(${name})`;
  return getComputedStyle(element).caretColor;
}

function powersOfTen(least, most) {
  const powers = [];
  for (let power = least; power <= most * 1.0001; power *= 10) powers.push(power);
  return powers;
}

function size(element) {
  return { width: Math.max(200, Math.floor(element.clientWidth)), height: 190 };
}

/** Say what a chart shows, for screen readers. */
function inWords(chart, times, columns) {
  const minutes = Math.max(1, Math.round((times.at(-1) - times[0]) / 60));
  const said = chart.series.map((one, index) => {
    const values = columns[index].filter((value) => value !== null);
    if (values.length === 0) return `${one.name} unknown`;
    const last = columns[index].at(-1);
    const now = last === null ? "unknown now" : `${number(last)} ${chart.unit} now`;
    const least = values.reduce((a, b) => Math.min(a, b));
    const most = values.reduce((a, b) => Math.max(a, b));
    return `${one.name} ${now}, ${number(least)} to ${number(most)}`;
  });
  return `In ${minutes === 1 ? "the last minute" : `${minutes} minutes`}: ${said.join("; ")}.`;
}
