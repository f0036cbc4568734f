// Keeps the page up to date: the status once a second while the page is visible, the history after a gap.

import { Charts } from "./charts.js";
import { Fields, clock } from "./fields.js";

const PERIOD_MS = 1000;
const SLOWEST_MS = 5000; // between two tries while the daemon does not answer
const TIMEOUT_MS = 4000;
const STALE_S = 3; // STALE_AFTER_S of arpd/report/situation.py
const GAP_S = 5; // shorter gaps stay in the charts

const fields = new Fields(document.body);
const charts = new Charts(document.getElementById("charts"));
const freshness = document.getElementById("freshness");
const announcement = document.getElementById("announcement");

let seen = null; // the last document, and when it came
let failure = ""; // why there is no newer document
let failures = 0;
let timer = 0;
let isAsking = false;

async function ask(path) {
  const answer = await fetch(path, { cache: "no-store", signal: AbortSignal.timeout(TIMEOUT_MS) });
  if (answer.status === 401) throw new Error("the daemon asks for a password; reload the page");
  if (answer.status === 429) throw new Error("the daemon had too many wrong passwords from here");
  const body = await answer.json().catch(() => null);
  if (answer.status === 503 && body?.api_version) throw new Error("the daemon is starting");
  if (!answer.ok || !body?.api_version) throw new Error(`the daemon answers ${answer.status}`);
  return body;
}

async function update() {
  const status = await ask("api/v1/status");
  if (seen === null || status.unix_time_seconds - seen.status.unix_time_seconds > GAP_S) {
    charts.load(await ask("api/v1/history"));
  }
  seen = { status, atMs: performance.now() };
  fields.fill(status);
  charts.append(status);
}

async function poll() {
  clearTimeout(timer);
  if (isAsking || document.hidden) return;
  isAsking = true;
  try {
    await update();
    failure = "";
    failures = 0;
  } catch (error) {
    failure = error.name === "TypeError" || error.name === "TimeoutError" ? "the daemon cannot be reached" : error.message;
    failures += 1;
  }
  isAsking = false;
  showFreshness();
  if (!document.hidden) timer = setTimeout(poll, Math.min(PERIOD_MS * Math.max(1, failures), SLOWEST_MS));
}

function ageS() {
  return (seen.status.age_seconds ?? 0) + (performance.now() - seen.atMs) / 1000;
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

document.addEventListener("visibilitychange", poll);
addEventListener("online", poll);
setInterval(() => document.hidden || showFreshness(), PERIOD_MS);
poll();
