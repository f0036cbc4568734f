// Keeps the page up to date: the status by server-sent events while the page is visible, the history after a gap.

import { Charts } from "./charts.js";
import { Fields, clock } from "./fields.js";
import { apply } from "./patch.js";
import { Topics } from "./topics.js";

const PERIOD_MS = 1000;
const AGAIN_MS = 2000; // between two tries while no event comes
const TIMEOUT_MS = 4000;
const HISTORY_TIMEOUT_MS = 10000; // it is large
const MOST_HISTORY_PAUSE_MS = 60000;
const STALE_S = 3; // STALE_AFTER_S of arpd/report/situation.py
const GAP_S = 5; // shorter gaps stay in the charts

const fields = new Fields(document.body);
const charts = new Charts(document.getElementById("charts"));
new Topics(document.getElementById("topics"), fields.rowsOf("topics"), () => seen && fields.fill(seen.status));
const live = document.getElementById("live");
const freshness = document.getElementById("freshness");
const announcement = document.getElementById("announcement");

let source = null; // of the events
let streamed = null; // the document that the next changes apply to
let seen = null; // the last document, its age, and when it came
let failure = ""; // why there is no newer document
let nextCheckMs = performance.now() + AGAIN_MS;
let hasHistory = false;
let isLoading = false; // the history
let nextHistoryMs = 0;
let historyPauseMs = PERIOD_MS; // after the next failure

async function ask(path, timeoutMs = TIMEOUT_MS) {
  const answer = await fetch(path, { cache: "no-store", signal: AbortSignal.timeout(timeoutMs) });
  if (answer.status === 401) throw new Error("the daemon asks for a password; reload the page");
  if (answer.status === 429) throw new Error("the daemon had too many wrong passwords from here");
  const body = await answer.json().catch(() => null);
  if (answer.status === 503 && body?.api_version) throw new Error("the daemon is starting");
  if (!answer.ok || !body?.api_version) throw new Error(`the daemon answers ${answer.status}`);
  return body;
}

/** Show a document. Only a whole one knows its age; after a patch, a new time in it means a new tick. */
function receive(status, age) {
  const last = seen;
  seen = { status, age, atMs: performance.now(), unixTime: status.unix_time_seconds };
  failure = "";
  fields.fill(status);
  live.hidden = false;
  if (last === null || Math.abs(seen.unixTime - last.unixTime) > GAP_S) hasHistory = false;
  if (hasHistory) charts.append(status);
  else loadHistory();
  showFreshness();
}

/** Without a history the charts wait; the events tell whether the daemon is there. */
async function loadHistory() {
  if (isLoading || performance.now() < nextHistoryMs) return;
  isLoading = true;
  const history = await ask("api/v1/history", HISTORY_TIMEOUT_MS).catch(() => null);
  isLoading = false;
  if (history === null) {
    nextHistoryMs = performance.now() + historyPauseMs;
    historyPauseMs = Math.min(2 * historyPauseMs, MOST_HISTORY_PAUSE_MS);
    return;
  }
  hasHistory = true;
  historyPauseMs = PERIOD_MS;
  charts.load(history);
}

function patch(operations) {
  try {
    apply(streamed, operations);
  } catch {
    close(); // the next stream begins with a whole document
    open();
    return;
  }
  receive(streamed, streamed.unix_time_seconds === seen.unixTime ? ageS() : 0);
}

function open() {
  if (source !== null || document.hidden) return;
  source = new EventSource("api/v1/stream");
  source.addEventListener("status", ({ data }) => {
    streamed = JSON.parse(data);
    receive(streamed, streamed.age_seconds);
  });
  source.addEventListener("changes", ({ data }) => patch(JSON.parse(data)));
  source.addEventListener("error", () => performance.now() > nextCheckMs && check());
}

function close() {
  source?.close();
  source = null;
}

/** Without events, one request tells why: the browser hides the reason, and events that a proxy holds back look like none. */
async function check() {
  nextCheckMs = performance.now() + AGAIN_MS;
  try {
    const status = await ask("api/v1/status");
    receive(status, status.age_seconds);
    if (source?.readyState === EventSource.CLOSED) close();
    open();
  } catch (error) {
    fail(error);
  }
}

function fail(error) {
  failure = error.name === "TypeError" || error.name === "TimeoutError" ? "the daemon cannot be reached" : error.message;
  nextCheckMs = Math.min(nextCheckMs, performance.now() + PERIOD_MS);
  showFreshness();
}

function ageS() {
  return seen.age + (performance.now() - seen.atMs) / 1000;
}

function look() {
  if (document.hidden) return;
  showFreshness();
  const isQuiet = seen === null || performance.now() - seen.atMs > AGAIN_MS;
  if ((failure || isQuiet) && performance.now() > nextCheckMs) check();
}

function showFreshness() {
  if (seen === null && !failure) return; // the first answer is on its way
  const isOld = seen !== null && ageS() > STALE_S;
  const state = failure ? "lost" : isOld ? "stale" : "live";
  document.body.dataset.freshness = state;
  const said = [];
  if (failure) said.push(failure);
  if (state === "stale") said.push("the daemon hangs: no tick finishes");
  if (state === "live") said.push("live");
  if (seen !== null) {
    const when = `as of ${clock(seen.status.unix_time_seconds)}`;
    said.push(state === "live" ? when : `${when}, ${Math.round(ageS())} s ago`);
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

document.addEventListener("visibilitychange", () => (document.hidden ? close() : open()));
addEventListener("online", check);
setInterval(look, PERIOD_MS);
open();
