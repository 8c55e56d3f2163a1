"use strict";
// The band that is always in view: the one place of the state, with time left, limits and STOP. While a motor may move, any key stops it.
const Band = (function () {
  const ANSWER = 1000, ENDED = 3000, CUT = "CUT THE POWER";  // ms until an answer to STOP, and until the end of the run, must have come
  const NAMES = { record: "Recording", doctor: "Checking the stand", readings: "Reading at rest", identify: "Identifying", compare: "Comparing", export: "Exporting", design: "Searching the best excitation", stand: "Writing the stand file" };
  const at = (id) => document.getElementById(id);
  const bare = (line) => (line || "").replace(/^(hil: |error: |warning: )+/, "");
  let job = null, awaited = 0, press = null, ends = 0, wasMoving = false, lost = false, alarm = null, changed = () => {}, plain = bare;

  const starting = () => awaited > (job ? job.number : 0);  // the command's number, unknown until the server has answered
  const running = () => Boolean(job && job.status === null);
  const moving = () => starting() || Boolean(running() && job.moves);
  const keys = () => (document.hasFocus() ? "Any key stops." : "Click into this page: then any key stops.");
  const put = (id, text) => { if (at(id).textContent !== text) at(id).textContent = text; };  // else a screen reader says it again
  const mark = (state) => `${state.number} ${state.output} ${state.command}`;

  // ---- what is known: {tone, text, more, command}. A person must see the worst first.
  function known() {
    const command = running() && job.process ? `kill -INT ${job.process}` : "pkill -INT -f 'hil record'";
    if (press && press.silent) return { tone: "bad", text: "hil does not answer: cut the power", more: "STOP was sent, and no answer names it. To stop the run from a terminal:", command };
    if (press && press.late && moving() && !(job && job.off_after !== null)) return { tone: "bad", text: "STOP was received, and the run has not ended: cut the power", more: "To send it from a terminal:", command };
    if (alarm) return { tone: "bad", ...alarm };
    if (lost && wasMoving) return { tone: "bad", text: "Connection lost while a motor moved", more: `${byTheClock()} To stop it now, cut the power, or in a terminal:`, command };
    if (lost) return { tone: "warn", text: "Connection lost, nothing was moving", more: "If the terminal of hil studio was closed, start it again and open the new link." };
    if (press && press.answered !== true) return { tone: "moves", text: "STOP sent" };
    if (starting()) return { tone: "moves", text: `Starting. ${keys()}` };
    if (job && job.moves && job.stops) {
      if (job.off_after !== null) return { tone: "still", text: `Torque off after ${Math.round(1000 * job.off_after)} ms.` };
      return running() ? { tone: "moves", text: "Stopping ..." } : { tone: "still", text: "Stopped." };
    }
    if (moving()) return { tone: "moves", text: `${NAMES[job.kind]}. ${keys()}` };
    return running() ? { tone: "works", text: `${NAMES[job.kind]} ...` } : { tone: "still", text: "Nothing moves." };
  }

  function byTheClock() {
    if (!ends) return "When it ends is not known.";
    const seconds = Math.ceil((ends - Date.now()) / 1000), time = new Date(ends).toLocaleTimeString();
    return seconds > 0 ? `By the clock it ends at ${time}, in ${seconds} s, under its guard.` : `By the clock it ended at ${time}.`;
  }

  function show() {
    const { tone, text, more, command } = known(), live = moving() && !starting() && !lost && !(press && press.silent) && job.live;  // of now, not of a server that is silent
    at("band").dataset.tone = tone;
    put("state", text);
    put("more", more || "");
    at("more").hidden = !more;
    at("rescue").hidden = !command;
    put("rescue-line", command || "");
    at("read").hidden = !(alarm && text === alarm.text);
    put("stop", press && !press.silent ? "STOP sent" : "STOP");
    at("clock").hidden = at("elapsed").hidden = !live;
    if (live) {
      put("left", `${live.left.toFixed(1)} s`);
      at("elapsed").value = live.duration ? 1 - live.left / live.duration : 0;
      limits(live.margins.map((one) => [one.name, one.reading, one.limit, one.unit]), "now, in per cent of the limits");
    }
    document.body.dataset.moving = moving() ? "yes" : "no";
    document.title = tone === "bad" ? `! ${text}` : moving() ? "moves: hil studio" : "hil studio";
    changed(moving());
  }

  // Show the limits. rows: [name, reading or null, limit, unit]. what: what the readings are.
  function limits(rows, what) {
    at("limits").ariaLabel = what;
    while (at("limits").children.length > rows.length) at("limits").lastElementChild.remove();
    rows.forEach(([name, reading, limit, unit], row) => {
      const most = Plots.engineering(limit, unit), now = Plots.engineering(reading, unit), same = most.slice(most.indexOf(" "));
      const words = reading === null ? most : `${now.endsWith(same) ? now.slice(0, -same.length) : now} of ${most}`;
      if (!at("limits").children[row]) {
        at("limits").append(document.createElement("li"));
        at("limits").lastElementChild.append(...["span", "b", "meter", "small"].map((kind) => document.createElement(kind)));
      }
      const [label, share, meter, value] = at("limits").children[row].children;
      [label.textContent, share.textContent, value.textContent] = [name, reading === null ? "" : `${Math.round(100 * reading / limit)} %`, words];
      Object.assign(meter, { min: 0, max: 1, low: 0.7, high: 0.9, optimum: 0, value: reading === null ? 0 : reading / limit, ariaLabel: `${name}: ${words}` });
    });
  }

  // ---- what happens
  function told(state) {
    if (!state.number) { wasMoving = false; show(); return; }  // a server that has run no command yet
    const isNew = !job || job.number !== state.number;
    if (isNew && press && press.early && state.status === null && !state.stops) { job = state; press = null; stop(); }  // it came before the command
    job = state;
    if (press && (state.stops > (state.number === press.number ? press.stops : 0) || (!starting() && state.status !== null && state.number > press.number))) answered(press);
    if (!starting()) awaited = 0;
    if (press && press.answered === true && !moving()) press = null;
    wasMoving = moving();
    ends = wasMoving && state.live ? Date.now() + 1000 * state.live.left : 0;
    judge(state);
    show();
  }

  // The alarm of a run that broke off, or whose torque-off is not confirmed; it stays until a person has read it.
  function judge(state) {
    const lines = [state.alarm || "", ...state.said, ...((state.answer && state.answer.checks) || []).map((one) => one.message)], isRead = sessionStorage.getItem("hil-studio-read") === mark(state);
    const cut = lines.find((one) => one.includes(CUT)), broke = state.moves && state.live && state.status !== null && ![0, 1].includes(state.status) && !state.stops;
    if (!state.alarm && (isRead || !(broke || cut && state.moves))) return;
    const word = cut ? cut.slice(cut.indexOf(CUT) + CUT.length).replace(/^[:\s]+/, "") : bare(lines[lines.length - 1]);
    alarm = { text: cut || !word ? CUT : "The run broke off", more: plain(word) || `The recorder ended with status ${state.status} and said nothing. Whether the torque is off is not known.` };
  }

  function acknowledge() {
    if (job) sessionStorage.setItem("hil-studio-read", mark(job));
    Link.ask("/api/acknowledge", {}).catch(() => null);
    alarm = null;
    show();
  }

  function answered(mine) { Object.assign(mine, { answered: true, silent: false }); }
  function stop() {
    const mine = press && press.answered !== true ? press : { number: job ? job.number : 0, stops: running() ? job.stops : 0, early: starting() };
    if (press !== mine) setTimeout(() => { mine.silent = mine.answered !== true && press === mine; show(); }, ANSWER);
    if (press !== mine) setTimeout(() => { mine.late = press === mine; show(); }, ENDED);
    press = mine;
    Link.stop().then(() => { answered(mine); if (press === mine && !moving()) press = null; }, () => { mine.silent = mine.answered !== true; }).then(show);
    show();
  }

  // A command is asked for: true; the server has refused it: 0; it has this number.
  function begun(number) {
    awaited = number === true ? Infinity : number;
    if (number === 0 && press && press.answered === true) press = null;
    if (number === true) window.focus();
    show();
  }

  // Return whether the connection had been lost: then another server may answer, which must look for a run that goes on.
  function opened() { const was = lost; lost = false; job = null; if (press && press.silent) press = null; if (awaited < Infinity) awaited = 0; show(); return was; }
  function closed() { lost = true; show(); }

  at("rescue").firstElementChild.id = "rescue-line";
  at("clock").firstElementChild.id = "left";
  at("stop").addEventListener("pointerdown", stop);  // a click comes only when the button is let go, a tenth of a second later
  at("stop").addEventListener("click", (event) => { if (!event.detail) stop(); });  // of a key or a screen reader
  at("read").addEventListener("click", acknowledge);
  window.addEventListener("keydown", (event) => {
    if (!moving()) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) stop();
  }, true);
  for (const event of ["focus", "blur"]) window.addEventListener(event, show);
  setInterval(() => { if (lost) show(); }, 1000);

  return { told, begun, opened, closed, moving, limits, bare, alarmed: () => Boolean(alarm), onChange: (work, words) => { changed = work; plain = words; } };
})();
