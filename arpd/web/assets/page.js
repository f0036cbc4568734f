// Keeps the page up to date: asks for the status while the page is visible, and for the history after a gap.

import { Charts } from "./charts.js";
import { Fields, clock } from "./fields.js";
import { Topics } from "./topics.js";

const PERIOD_MS = 1000;
const TIMEOUT_MS = 4000;
const HISTORY_TIMEOUT_MS = 10000; // it is large
const HISTORY_PAUSE_MS = 10000; // after a failure
const STALE_S = 3; // Condition.STALE of arpd/report/conditions.py
const GAP_S = 5; // shorter gaps stay in the charts

const fields = new Fields(document.body);
const charts = new Charts(document.getElementById("charts"));
new Topics(document.getElementById("topics"), fields.rowsOf("topics"), () => seen && fields.fill(seen.status));
const live = document.getElementById("live");
const freshness = document.getElementById("freshness");
const announcement = document.getElementById("announcement");

let seen = null; // the last document, and when it came
let failure = ""; // why there is no newer one
let timer = 0; // of the next question
let hasHistory = false;
let isLoading = false; // the history
let nextHistoryMs = 0;

async function ask(path, timeoutMs = TIMEOUT_MS) {
  const answer = await fetch(path, { cache: "no-cache", signal: AbortSignal.timeout(timeoutMs) });
  if (answer.status === 401) throw new Error("the daemon asks for a password; reload the page");
  if (answer.status === 429) throw new Error("the daemon had too many wrong passwords from here");
  const body = await answer.json().catch(() => null);
  if (answer.status === 503 && body?.api_version) throw new Error("the daemon is starting");
  if (!answer.ok || !body?.api_version) throw new Error(`the daemon answers ${answer.status}`);
  return body;
}

function receive(status) {
  const step = seen === null ? Infinity : status.unix_time_s - seen.status.unix_time_s;
  seen = { status, atMs: performance.now() };
  failure = "";
  fields.fill(status);
  live.hidden = false;
  if (step < 0 || step > GAP_S) hasHistory = false; // somebody may have set the clock
  if (hasHistory) charts.append(status);
  else loadHistory();
}

/** Without a history the charts wait; the status tells whether the daemon is there. */
async function loadHistory() {
  if (isLoading || performance.now() < nextHistoryMs) return;
  isLoading = true;
  const history = await ask("api/v1/history", HISTORY_TIMEOUT_MS).catch(() => null);
  isLoading = false;
  nextHistoryMs = performance.now() + (history === null ? HISTORY_PAUSE_MS : 0);
  hasHistory = history !== null;
  if (hasHistory) charts.load(history, seen.status);
}

/** Ask once, and again a second later; nobody asks while nobody looks. */
async function look() {
  clearTimeout(timer);
  timer = 0;
  try {
    receive(await ask("api/v1/status"));
  } catch (error) {
    failure = ["TypeError", "TimeoutError"].includes(error.name) ? "the daemon cannot be reached" : error.message;
  }
  showFreshness();
  if (timer === 0 && !document.hidden) timer = setTimeout(look, PERIOD_MS);
}

function showFreshness() {
  const ageS = seen === null ? 0 : seen.status.age_s + (performance.now() - seen.atMs) / 1000;
  const state = failure ? "lost" : ageS > STALE_S ? "stale" : "live";
  document.body.dataset.freshness = state;
  const said = [];
  if (failure) said.push(failure);
  if (state === "stale") said.push("the daemon hangs: no tick finishes");
  if (state === "live") said.push("live");
  if (seen !== null) {
    const when = `as of ${clock(seen.status.unix_time_s)}`;
    said.push(state === "live" ? when : `${when}, ${Math.round(ageS)} s ago`);
  }
  freshness.textContent = said.join(" · ");
  announce(state === "live" ? seen.status.verdict?.headline : said[0]);
}

/** Tell a screen reader about a new headline, not about each new number. */
function announce(headline) {
  if (headline && announcement.dataset.headline !== headline) {
    announcement.dataset.headline = headline;
    announcement.textContent = document.body.dataset.freshness === "live" ? seen.status.verdict.text : headline;
  }
}

document.addEventListener("visibilitychange", () => (document.hidden ? clearTimeout(timer) : look()));
look();
