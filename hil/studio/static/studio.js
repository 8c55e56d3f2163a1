"use strict";
// The page of hil studio: shows what the commands write, and starts and stops them. Texts of files become text, never markup.
(function () {
  const PREFIXES = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "\u00b5"], [1e-9, "n"]];
  const WINDOW = 20, EXPORTS = [".csv", ".parquet", ".mat", ".mcap", ".xml", ".urdf", ".sdf", ".h", ".json"], PAGE = 50;
  const at = (id) => document.getElementById(id);
  const plots = {
    torque: new Plots.Time("torque-plot", "torque [N m]", ["set-point", "torque"]),
    dtheta: new Plots.Time("dtheta-plot", "deflection [rad]", ["deflection"]),
    loop: new Plots.Loop("loop-plot"),
    trace: new Plots.Time("trace-plot", "torque [N m]", ["torque"], chooseWindow),
    overlay: new Plots.Loop("overlay-plot"),
  };
  let table = { stands: [], recordings: [], profiles: {} }, first = 0;
  let job = null, awaited = 0, store = null, drawing = 0, pressed = false, link = null, lost = false, agree = null;
  let finished = -1, output = "", predicting = 0, timer = 0, traced = "", listed = "", began = 0;

  // ---- small things
  function make(kind, text, more) {
    const one = document.createElement(kind);
    if (text !== undefined) one.textContent = text;
    return Object.assign(one, more || {});
  }

  function engineering(value, unit, figures) {
    if (value === null || value === undefined || !Number.isFinite(value)) return "\u2013";
    const [factor, prefix] = value === 0 ? [1, ""] : PREFIXES.find(([one]) => Math.abs(value) >= 0.9995 * one) || PREFIXES[PREFIXES.length - 1];
    return `${(value / factor).toPrecision(figures || 3).replace("-", "\u2212")} ${prefix}${unit}`;
  }

  function pairs(place, entries) {
    place.replaceChildren(...entries.map(([name, value]) => { const one = make("div"); one.append(make("dt", name), make("dd", value)); return one; }));
  }

  function say(text) { at("banner").textContent = text; at("banner").hidden = !text; }

  async function ask(path, sent) {
    const answer = await fetch(path, sent === undefined ? {} : { method: "POST", body: JSON.stringify(sent), headers: { "content-type": "application/json" } });
    const isJson = (answer.headers.get("content-type") || "").startsWith("application/json");
    const given = isJson ? await answer.json() : answer.ok ? await answer.arrayBuffer() : { refused: await answer.text() };
    if (!answer.ok) throw new Error(given.refused || `the server answered ${answer.status}`);
    return given;
  }

  async function trying(work) {
    try { say(""); return await work(); } catch (error) { say(error.message); return null; }
  }

  const starting = () => awaited > (job ? job.number : 0);  // the command's number, unknown until the server has answered
  const moving = () => starting() || Boolean(job && job.moves && job.status === null);
  const stand = () => table.stands.find((one) => one.file === chosenStand()) || table.stands[0];
  const chosenStand = () => { const one = document.querySelector("#stands input:checked"); return one ? one.value : "sim"; };
  const chosen = () => [...document.querySelectorAll("#recordings input:checked")].map((one) => one.value);

  // ---- the three steps
  function go(step) {
    for (const one of ["stand", "record", "identify"]) at(one).hidden = one !== step;
    document.querySelectorAll("nav button").forEach((one) => { if (one.dataset.step === step) one.setAttribute("aria-current", "step"); else one.removeAttribute("aria-current"); });
    if (step === "record") { at("chosen").textContent = stand().name; predict(); }
    if (step === "identify") refresh();
    Object.values(plots).forEach((one) => one.draw());
  }

  async function refresh() {
    table = await ask(`/api/folder?first=${first}&find=${encodeURIComponent(at("find").value)}`);
    at("folder").textContent = table.folder;
    showStands();
    showRecordings();
    const profile = at("excitation").elements.profile;
    if (!profile.length) at("draft").elements.backend.append(...table.drives.map((name) => make("option", name)));
    if (!profile.length) profile.append(...Object.keys(table.profiles).map((name) => make("option", name, { value: name, selected: name === "chirp" })));
  }

  function showStands() {
    const before = chosenStand();
    const lines = table.stands.map((one) => {
      const label = make("label"), input = make("input", undefined, { type: "radio", name: "stand", value: one.file, disabled: Boolean(one.wrong), checked: one.file === before });
      const limits = one.limits ? `; limits ${engineering(one.limits.torque, "N m")}, ${engineering(one.limits.deflection, "rad")}, ${engineering(one.limits.velocity, "rad/s")}` : "";
      label.append(input, ` ${one.name} `, make("span", one.wrong || `(${one.file === "sim" ? "" : one.file + ", "}${[one.backend, one.place].filter(Boolean).join(" at ")}${limits})`, { className: one.wrong ? "error" : "soft" }));
      return label;
    });
    at("stands").replaceChildren(at("stands").firstElementChild, ...lines);
    showMoves();
  }

  function showMoves() { at("move").disabled = at("commission").disabled = stand().simulated; }

  async function askAboutDrive() {
    const form = at("draft"), backend = form.elements.backend.value;
    const found = backend ? await ask(`/api/questions?backend=${backend}`) : [];
    form.replaceChildren(...[...form.children].slice(0, 2), ...found.map((one) => {
      const label = make("label", `${one.key} `), list = make("datalist", undefined, { id: `known-${one.key}` });
      const field = make("input", undefined, { name: one.key, autocomplete: "off", placeholder: one.default === null ? "needed" : String(one.default) });
      list.append(...one.known.map((text) => make("option", text, { value: text.split(" (")[0] })));
      field.setAttribute("list", list.id);
      label.append(field, make("small", one.meaning, { className: "soft" }), list);
      return label;
    }));
  }

  function writeStand() {
    const { backend, file, ...answers } = Object.fromEntries(new FormData(at("draft")));
    begin({ kind: "stand", backend, file, answers });
  }

  function takeBest({ kind, mode, amplitude, duration, band_low: low, band_high: high }) {
    const fields = at("excitation").elements;
    const best = { profile: kind, mode, amplitude, duration, band: low === high ? low : `${low}:${high}` };
    for (const [name, value] of Object.entries(best)) fields[name].value = value;
    predict();
  }

  function showRecordings() {
    const kept = chosen(), entries = JSON.stringify(table.recordings);
    if (entries !== listed) at("recordings").replaceChildren(...table.recordings.map((one) => {  // else a click or the focus would be lost
      const row = make("tr"), label = make("label"), report = make("td");
      label.append(make("input", undefined, { type: "checkbox", value: one.file, checked: kept.includes(one.file), ariaLabel: `choose ${one.file}` }));
      if (one.report) report.append(make("button", "Show", { type: "button", ariaLabel: `show the report of ${one.file}`, onclick: () => showReport(one.report) }));
      const cells = [make("td"), make("td", one.file), make("td", new Date(1000 * one.changed).toLocaleString()), make("td", one.answer || "not identified"), report];
      cells[0].append(label);
      row.append(...cells);
      return row;
    }));
    listed = entries;
    const last = Math.min(first + PAGE, table.count);
    at("count").textContent = table.count ? `${first + 1} to ${last} of ${table.count}, newest first` : "no recording yet";
    at("newer").disabled = first === 0;
    at("older").disabled = last >= table.count;
  }

  // ---- commands
  async function begin(wanted) {
    if (moving()) return;
    const moves = ["record", "doctor"].includes(wanted.kind) && wanted.stand !== "sim" || wanted.kind === "record";
    awaited = moves ? Infinity : 0;
    began = performance.now();
    pressed = false;
    showReport("");  // its frame would take the keys that stop
    const answer = await trying(() => ask("/api/start", wanted));
    awaited = answer && moves ? answer.number : 0;
    if (!answer) pressed = false;
    showState();
  }

  function start() {
    const form = Object.fromEntries(new FormData(at("excitation"))), one = stand();
    const wanted = { kind: "record", stand: one.file, ...form };
    if (one.simulated) { begin(wanted); return; }
    const words = one.asked.replace("{size}", form.amplitude || "a fifth of the limit").replace("{time}", form.duration || "20 s");
    question(words, () => begin({ ...wanted, yes: true }));
  }

  function move() {
    const words = stand().asked.replace("{size}", "a twentieth of the limit").replace("{time}", "3 s");
    question(words, () => begin({ kind: "doctor", stand: chosenStand(), move: true, yes: true }));
  }

  function question(text, agreed) {
    at("asked").textContent = `${text}\nWhile it moves, STOP and any key stop it.`;
    agree = agreed;
    at("question").showModal();
  }

  function stop() {
    pressed = moving();
    at("stop").textContent = "STOP sent";
    const press = String(Math.random());  // the open connection is faster, and the request goes where that one hangs
    if (link && link.readyState === WebSocket.OPEN) link.send(press);
    fetch(`/api/stop?press=${press}`, { method: "POST", keepalive: true }).then((answer) => { if (!answer.ok) throw new Error(); return answer.json(); }).then((answer) => {
      if (!answer.running) at("stop").textContent = "STOP";
    }).catch(() => say("STOP did not reach hil studio: press Ctrl-C in its terminal, or cut the power of the motor."));
  }

  // ---- what the server tells
  function connect() {
    link = new WebSocket(`ws://${location.host}/api/stream`);
    link.binaryType = "arraybuffer";
    link.onopen = () => { store = null; if (awaited < Infinity) awaited = 0; if (lost) { lost = false; say(""); } };
    link.onmessage = ({ data }) => { if (typeof data === "string") told(JSON.parse(data)); else rows(data); };
    link.onclose = () => {
      if (moving() || lost) {
        const left = job && job.live ? ` It ends by itself in about ${Math.ceil(job.live.left)} s.` : "";
        say(`The connection to hil studio is lost. A run goes on under its guard.${left} To stop it: Ctrl-C in the terminal of hil studio, or the power of the motor.`);
      } else say("The connection to hil studio is lost. If its terminal was closed, start it again and open the new link.");
      lost = true;
      setTimeout(connect, 1000);
    };
  }

  function rows(data) {
    store = store || new Plots.Store(WINDOW * 10000);
    store.add(Plots.unpacked(data));
    drawing = drawing || requestAnimationFrame(draw);  // not where nothing is new, nor in a hidden tab
  }

  function told(state) {
    if (!job && state.status !== null) finished = state.number;  // it ended before this page was opened
    else if (!job || job.number !== state.number) {
      if (pressed && !state.stops && state.status === null) stop();  // the first one came before the command
      store = null;
      pressed = false;
      if (state.moves) showReport("");
      if (state.kind === "record") { plots.torque.clear(); plots.dtheta.clear(); plots.loop.clear(); go("record"); }
    }
    job = state;
    if (!starting()) { awaited = 0; pressed = pressed && job.status === null; }
    showState();
    if (job.number === finished && job.status !== null) return;
    at("said").replaceChildren(...job.said.map((one) => make("li", one, { className: job.status && !job.stops ? "error" : "" })));
    if (job.kind === "record") showRun();
    if (job.kind === "readings") showReading();
    if (job.kind === "doctor") showChecks();
    if (job.kind === "design" && job.status === null) at("predicted").textContent = job.said[job.said.length - 1] || "searching ...";
    const busy = job.status === null && ["identify", "compare", "export"].includes(job.kind);
    at("progress").hidden = !busy;
    if (busy) at("progress").lastElementChild.textContent = `${job.said[job.said.length - 1] || job.command} (${Math.round((performance.now() - began) / 1000)} s)`;
    if (job.status !== null && finished !== job.number) { finished = job.number; ended(); }
  }

  function showState() {
    const live = job && job.live;
    const names = { record: "Recording", doctor: "Checking the stand", readings: "Reading at rest", identify: "Identifying", compare: "Comparing", export: "Exporting", design: "Searching the best excitation", stand: "Writing the stand file" };
    let text = "Nothing moves.";
    if (starting()) text = "Starting. Any key stops.";
    else if (job && job.status === null) text = names[job.kind] + (moving() ? (live ? `, ${Math.ceil(live.left)} s left. Any key stops.` : ". Any key stops.") : "");
    if (!starting() && job && job.moves && job.stops) text = job.off_after !== null ? `Torque off after ${Math.round(1000 * job.off_after)} ms.` : job.status === null ? "Stopping ..." : "Stopped.";
    if (at("state").textContent !== text) at("state").textContent = text;
    at("stop").textContent = job && job.status === null && job.stops ? "STOP sent" : "STOP";
    document.body.dataset.moving = moving() ? "yes" : "no";
    at("start").disabled = moving();
  }

  function showRun() {
    const live = job.live;
    at("to-identify").hidden = true;
    at("predicted").textContent = "";
    if (!live) return;
    const [kc, bc] = live.estimate || [null, null];
    pairs(at("figures"), [
      ["time left", `${live.left.toFixed(1)} s`], ["rate", `${live.rate === null ? "\u2013" : live.rate.toFixed(0)} of ${live.planned.toFixed(0)} Hz`],
      ["set-points late by (99 %)", engineering(live.lateness, "s")], ["late ticks", String(live.late)], ["lost replies", String(live.lost)],
      ["Kc so far", engineering(kc, "N m/rad")], ["Bc so far", engineering(bc, "N m s/rad")],
    ]);
    showLimits(live.margins.map((one) => [one.name, one.reading, one.limit, one.unit]));
  }

  function showLimits(limits) {
    at("limits").replaceChildren(...limits.map(([name, reading, limit, unit]) => {
      const line = make("li"), words = `${name}: ${engineering(reading, unit)} of ${engineering(limit, unit)}, ${Math.round(100 * (1 - reading / limit))} % left`;
      line.append(words, make("meter", undefined, { min: 0, max: 1, low: 0.7, high: 0.9, optimum: 0, value: reading / limit, ariaLabel: words }));
      return line;
    }));
  }

  function showReading() {
    const one = job.answer, shown = at("reading");
    shown.hidden = !one;
    if (!one) return;
    if (one.lost) pairs(shown, [["reading", one.lost]]);
    else pairs(shown, [["motor", engineering(one.motor, "rad", 4)], ["joint", engineering(one.joint, "rad", 4)], ["torque at the joint", engineering(one.torque, "N m")], ["winding", one.temperature === null ? "\u2013" : `${one.temperature.toFixed(0)} \u00b0C`]]);
  }

  function showChecks() {
    const found = job.answer;
    if (!found) { at("checks").replaceChildren(); return; }
    const lines = found.checks.map((one) => [one.verdict, one.name, one.message]);
    if (found.commissioning) lines.unshift([found.commissioning.ok ? "ok" : "error", "commissioning", found.commissioning.verdict]);
    if (!lines.length) for (const kind of ["serial", "can"]) for (const one of found.ports[kind]) lines.push([one.problem ? "error" : "ok", one.name, one.problem || one.described || "can be used"]);
    if (!lines.length) lines.push(["ok", "simulated stand", "nothing to check; this computer has no serial port and no CAN interface"]);
    at("checks").replaceChildren(...lines.map(([verdict, name, message]) => { const line = make("li", undefined, { className: verdict }); line.append(make("b", verdict), ` ${name}: ${message}`); return line; }));
  }

  function ended() {
    const bad = job.status !== 0 && !job.stops;
    const asks = job.kind === "doctor" && job.status === 2 && !job.answer && job.command.includes("--commission") && !job.command.includes("--yes");
    const words = job.said.filter((one) => !one.startsWith("nothing was driven") && !one.startsWith("hil: nothing was driven"));
    if (asks) { question(words.join("\n"), () => begin({ kind: "doctor", stand: chosenStand(), commission: true, yes: true })); at("said").replaceChildren(); return; }
    if (job.kind === "record" && job.answer && job.answer.recording) {
      output = job.answer.recording;
      at("to-identify").hidden = false;
      at("predicted").textContent = `${output}: ${job.answer.samples} samples, ${job.answer.lost} lost, ${job.answer.late} late (${job.answer.end_reason})`;
      at("to-identify").focus();
    }
    if (job.kind === "stand" && job.status === 0) trying(refresh).then(() => { document.querySelector(`#stands [value="${CSS.escape(job.output)}"]`).checked = true; showMoves(); at("new").open = false; });
    if (job.kind === "design") { at("predicted").textContent = ""; if (job.answer) takeBest(job.answer.profiles.best.profile); }
    if (["identify", "compare"].includes(job.kind)) { trying(refresh); if (job.answer) showReport(job.output); }
    if (job.kind === "export" && job.status === 0) Object.assign(at("exported"), { textContent: `save ${job.output}`, href: `/api/file?name=${encodeURIComponent(job.output)}`, hidden: false });
    if (bad && !job.answer) at("said").scrollIntoView({ block: "nearest" });
  }

  function draw() {
    drawing = 0;
    if (store) {
      const { planned: rate, mode } = (job && job.live) || { planned: 500 }, [time, command, torque, dtheta] = store.newest(Math.ceil(WINDOW * rate));
      const byTorque = mode !== "position";
      plots.torque.show(byTorque ? [time, command, torque] : [time, torque], byTorque ? ["set-point", "torque"] : ["torque"]);
      plots.dtheta.show(byTorque ? [time, dtheta] : [time, command, dtheta], byTorque ? ["deflection"] : ["set-point", "deflection"]);
      const few = Math.min(time.length, 4 * plots.loop.width), from = time.length - few;
      plots.loop.show([[dtheta.subarray(from), torque.subarray(from)]]);
    }
  }

  // ---- the preview of a run
  function predict() {
    const form = Object.fromEntries(new FormData(at("excitation")));
    at("explained").textContent = table.profiles[form.profile] || "";
    clearTimeout(timer);
    if (moving()) return;
    timer = setTimeout(async () => {
      predicting += 1;
      const mine = predicting;
      at("predicted").textContent = "predicting ...";
      const found = await ask("/api/preview", { stand: chosenStand(), ...form }).catch((error) => ({ refused: error.message }));
      if (mine !== predicting || moving() || store) return;
      at("predicted").textContent = found.refused || found.said || `predicted standard errors: Kc ${share(found.errors.Kc)}, Bc ${share(found.errors.Bc)}; amplitude ${engineering(found.amplitude, form.mode === "torque" ? "N m" : "rad")}, ${found.duration} s`;
      if (found.refused) return;
      showLimits(Object.entries(found.limits).map(([name, one]) => [`predicted ${name}`, one.peak, one.limit, one.unit]));
      const { time, command, torque, dtheta } = found.curves, isTorque = form.mode !== "position";
      const lines = [...(isTorque ? [["set-point", command]] : []), ...(torque ? [["predicted torque", torque]] : [])];
      if (lines.length) plots.torque.show([time, ...lines.map((one) => one[1])], lines.map((one) => one[0])); else plots.torque.clear();
      if (dtheta || !isTorque) plots.dtheta.show([time, dtheta || command], [dtheta ? "predicted deflection" : "set-point"]); else plots.dtheta.clear();
      if (dtheta) plots.loop.show([[dtheta, torque]]); else plots.loop.clear();
    }, 300);
  }

  const share = (value) => (value === null ? "not identifiable" : `${(100 * value).toPrecision(2)} %`);

  // ---- recordings
  async function trace() {
    const names = chosen().slice(0, 5);
    if (String(names) === traced) return;
    traced = String(names);
    at("from").value = at("to").value = "";
    if (!names.length) { plots.trace.clear(); plots.overlay.clear(); return; }
    const found = [];
    for (const name of names) {  // one after the other: a browser has few connections, and STOP needs one
      const data = await ask(`/api/trace?name=${encodeURIComponent(name)}`).catch((error) => { say(error.message); return null; });
      if (!data) { traced = ""; refresh(); return; }
      found.push(data);
    }
    if (String(names) !== traced) return;
    const frames = found.map(Plots.unpacked).map(({ begin, channels }) => [Float64Array.from(channels[0], (one) => one + begin), channels[2], channels[3]]);
    plots.trace.show(joined(frames), names);
    plots.overlay.show(frames.map(([, torque, dtheta]) => [dtheta, torque]));
  }

  // Lines with times of their own as columns over one time; null where a line has no sample.
  function joined(frames) {
    const tables = frames.map(([time, torque]) => [Array.from(time), Array.from(torque, (one) => (Number.isFinite(one) ? one : null))]);
    return tables.length === 1 ? tables[0] : uPlot.join(tables, tables.map(() => [0, 1]));
  }

  function chooseWindow(low, high) { at("from").value = low.toFixed(3); at("to").value = high.toFixed(3); }

  function showReport(name) {
    const place = at("report"), old = place.querySelector("iframe");
    if (old) old.remove();
    place.hidden = !name;
    if (!name) return;
    const address = `/api/report?name=${encodeURIComponent(name)}`;
    at("report-link").href = address;
    place.append(make("iframe", undefined, { src: address, title: `report ${name}`, sandbox: "allow-scripts" }));
    place.scrollIntoView({ block: "start" });
  }

  function later(work) { clearTimeout(timer); timer = setTimeout(work, 250); }

  // ---- what a person does
  const clicks = {
    start, "to-record": () => go("record"), no: () => at("question").close(),
    yes: () => { at("question").close(); agree(); },
    check: () => begin({ kind: "doctor", stand: chosenStand() }),
    readings: () => begin({ kind: "readings", stand: chosenStand() }),
    move, write: writeStand, design: () => begin({ kind: "design", stand: chosenStand(), ...Object.fromEntries(new FormData(at("excitation"))) }),
    commission: () => begin({ kind: "doctor", stand: chosenStand(), commission: true }),
    "to-identify": async () => { at("find").value = ""; first = 0; go("identify"); await refresh(); document.querySelectorAll("#recordings input").forEach((one) => { one.checked = one.value === output; }); trace(); identify(); },
    newer: () => { first = Math.max(0, first - PAGE); trying(refresh); }, older: () => { first += PAGE; trying(refresh); },
    "do-identify": identify, compare: () => begin({ kind: "compare", recordings: chosen() }),
    export: () => { at("exported").hidden = true; begin({ kind: "export", recordings: chosen(), suffix: at("suffix").value }); },
  };
  function identify() { begin({ kind: "identify", recordings: chosen(), from: at("from").value, to: at("to").value }); }

  Object.entries(clicks).forEach(([id, act]) => at(id).addEventListener("click", () => act()));
  document.querySelectorAll("nav button").forEach((one) => one.addEventListener("click", () => go(one.dataset.step)));
  at("stop").addEventListener("pointerdown", stop);  // a click comes only when the button is let go, a tenth of a second later
  at("stop").addEventListener("click", (event) => { if (!event.detail) stop(); });  // of a key or a screen reader
  at("stands").addEventListener("change", showMoves);
  at("draft").elements.backend.addEventListener("change", () => trying(askAboutDrive));
  at("excitation").addEventListener("input", predict);
  at("excitation").addEventListener("submit", (event) => event.preventDefault());
  at("recordings").addEventListener("change", trace);
  at("find").addEventListener("input", () => { first = 0; later(() => trying(refresh)); });
  at("suffix").append(...EXPORTS.map((one) => make("option", one)));
  window.addEventListener("keydown", (event) => {
    if (!moving()) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) stop();
  }, true);

  async function enter() {
    const token = location.hash.slice(1);
    if (token) {
      history.replaceState(null, "", location.pathname);
      const refused = await ask("/token", { token }).then(() => null, (error) => error);
      await refresh().catch((error) => { throw refused || error; });  // a browser that is in already needs no link
    } else await refresh();
    document.querySelectorAll("[inert]").forEach((one) => { one.inert = false; });  // no click before there is a stand
    go("stand");
    connect();
  }
  enter().catch((error) => say(error.message));
})();
