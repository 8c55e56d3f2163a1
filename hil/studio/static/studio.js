"use strict";
// The page of hil studio: shows what the commands write, and starts and stops them. Texts of files become text, never markup.
(function () {
  const WINDOW = 20, PAGE = 50, STEPS = ["stand", "record", "identify"];
  const MOST = 5, KEPT = "hil-studio-page", LEAST = 5e7;  // traces at once; what a reload keeps; bytes that a disk must have free
  const at = (id) => document.getElementById(id), all = (selector) => [...document.querySelectorAll(selector)];
  const ask = Link.ask, { engineering } = Plots, { moving } = Band, form = at("excitation"), draft = at("draft");
  const plots = {
    torque: new Plots.Time("torque-plot", "Set-point and torque stand here, predicted before a run and measured during it.", "torque [N m]", "N m", zoom),
    dtheta: new Plots.Time("dtheta-plot", "The deflection stands here.", "deflection [rad]", "rad", zoom),
    loop: new Plots.Loop("loop-plot", "Torque over deflection stands here: its slope is Kc, its width comes from Bc."),
    trace: new Plots.Time("trace-plot", "Choose a recording in the list: its torque stands here.", "torque [N m]", "N m", chooseWindow),
    overlay: new Plots.Loop("overlay-plot", "Its torque over deflection stands here."),
  };
  let table = { stands: [], recordings: [], profiles: {} }, first = 0, picked = [], step = "stand", chosenStand = "sim";
  let job = null, store = null, drawing = 0, showsRun = false, agree = null, finished = -1, output = "", predicting = null, timer = 0, traced = "", began = 0, shownReport = "", isFull = false;

  // ---- small things
  function make(kind, text, more) {
    const one = document.createElement(kind);
    if (text !== undefined) one.textContent = text;
    return Object.assign(one, more || {});
  }
  function pairs(place, entries) {
    place.replaceChildren(...entries.map(([name, value, note]) => { const one = make("div"); one.append(make("dt", name), make("dd", value)); if (note) one.append(make("dd", note, { className: "soft" })); return one; }));
  }
  function say(text) { at("banner").textContent = plain(text); at("banner").hidden = !text; }

  // Return a command's message in the words of this page: fields in place of options of the command line.
  function plain(text) {
    const named = (name) => { const field = all("main [name]").find((one) => one.name === name), label = field && field.parentElement.firstChild.textContent.trim(); return label ? `\u201c${label}\u201d` : null; };
    return Band.bare(text)
      .replace(/(add )?--set[= ]([\w.]+)=\S*/g, (whole, _, key) => (named(key) ? `fill in ${named(key)}` : whole))
      .replace(/^([\w.]+):/, (whole, key) => (named(key) ? `${named(key)}:` : whole))
      .replace(/--([a-z]+)\b(?!=)/g, (whole, name) => named(name) || whole); // --name=value is of a command line
  }
  async function trying(work) {
    try { say(""); return await work(); } catch (error) { say(error.message); return null; }
  }

  const stand = () => table.stands.find((one) => one.file === chosenStand && !one.wrong) || table.stands[0];
  const fields = (one) => Object.fromEntries(new FormData(one));
  const title = (key) => { const [group, name] = key.split("."), words = name.replaceAll("_", " "); return `${words[0].toUpperCase()}${words.slice(1)}${group === "limits" ? " limit" : ""}`; };
  const share = (value) => (value === null ? "not identifiable" : `${(100 * value).toPrecision(2)} %`);
  const torqueMode = () => form.elements.mode.value === "torque";
  function fill(values) { for (const [name, value] of Object.entries(values)) if (form.elements[name]) form.elements[name].value = value; }
  function later(work) { clearTimeout(timer); timer = setTimeout(work, 250); }
  function clearSaid() { at("said").replaceChildren(); say(""); }

  // ---- the three steps, and what a reload keeps
  function keep() { sessionStorage.setItem(KEPT, JSON.stringify({ step, stand: chosenStand, form: fields(form), picked, find: at("find").value, first })); }

  function go(to, isBack) {
    if (to !== step) clearSaid();
    step = to;
    if (!isBack && location.hash !== `#${to}`) history.pushState(null, "", `#${to}`);
    for (const one of STEPS) at(one).hidden = one !== to;
    all("nav button").forEach((one) => { if (one.dataset.step === to) one.setAttribute("aria-current", "step"); else one.removeAttribute("aria-current"); });
    if (to === "record") { at("chosen").textContent = stand().name; if (!moving()) predict(0); }
    if (to === "identify") { trying(refresh); trace(); }
    if (to !== "record") idleLimits();
    Object.values(plots).forEach((one) => one.draw());
    keep();
    line();
  }
  async function refresh() {
    table = await ask(`/api/folder?first=${first}&find=${encodeURIComponent(at("find").value)}`);
    at("folder").textContent = table.folder;
    showStands();
    showRecordings();
    if (form.elements.profile.length) return;
    draft.elements.backend.append(...table.drives.map((name) => make("option", name)));
    form.elements.profile.append(...Object.keys(table.profiles).map((name) => make("option", name, { value: name, selected: name === "chirp" })));
  }
  function showSpace(free) {
    isFull = free < LEAST;
    at("space").textContent = isFull ? `The disk is full (${engineering(free, "B", 2)} free): a run cannot be recorded. Remove files first.` : `${engineering(free, "B", 2)} free on the disk`;
    at("space").className = isFull ? "error" : "soft";
  }
  function idleLimits() {
    const { limits } = stand();
    if (!moving()) Band.limits(limits ? [["torque", null, limits.torque, "N m"], ["deflection", null, limits.deflection, "rad"], ["velocity", null, limits.velocity, "rad/s"]] : [], "limits of the stand");
  }

  // ---- stands
  function showStands() {
    at("stands").replaceChildren(at("stands").firstElementChild, ...table.stands.map((one) => {
      const label = make("label"), input = make("input", undefined, { type: "radio", name: "stand", value: one.file, disabled: Boolean(one.wrong), checked: one.file === stand().file });
      label.append(input, ` ${one.name} `, make("span", one.wrong ? plain(one.wrong) : one.file === "sim" ? "needs no drive" : `${one.file}, ${[one.backend, one.place].filter(Boolean).join(" at ")}`, { className: one.wrong ? "error" : "soft" }));
      return label;
    }));
    at("no-stand").hidden = table.stands.length > 1;
    showStand();
  }
  function showStand() {
    const one = stand();
    at("stand-name").textContent = one.name;
    at("place").textContent = one.simulated ? "A joint with known Kc and Bc: no motor moves." : [one.backend, one.place].filter(Boolean).join(" at ");
    [at("move").disabled, at("commission").disabled, at("row-of").hidden] = [one.simulated, one.simulated, !one.next];
    if (step !== "record") idleLimits();
  }
  function chooseStand(file) {
    chosenStand = file;
    at("checks").replaceChildren();
    at("reading").hidden = true;
    at("unchecked").hidden = false;
    clearSaid();
    showStand();
    keep();
    line();
  }
  async function askAboutDrive() {
    const backend = draft.elements.backend.value, found = backend ? await ask(`/api/questions?backend=${backend}`) : [];
    draft.replaceChildren(...[...draft.children].slice(0, 2), ...found.map((one) => {
      const label = make("label", `${title(one.key)} `), list = make("datalist", undefined, { id: `known-${one.key}` });
      const field = make("input", undefined, { name: one.key, autocomplete: "off", required: one.default === null, placeholder: one.default === null ? "needed" : String(one.default) });
      list.append(...one.known.map((text) => make("option", text, { value: text.split(" (")[0] })));
      field.setAttribute("list", list.id);
      label.append(field, make("small", one.meaning, { className: "soft" }), list);
      return label;
    }));
  }

  function writeStand() {
    const { backend, file, ...answers } = fields(draft), empty = [...draft.elements].find((one) => one.required && !one.value.trim());
    for (const one of draft.elements) one.ariaInvalid = one === empty ? "true" : null;
    if (!empty) { begin({ kind: "stand", backend, file, answers }); return; }
    say(empty.name === "backend" ? "Choose a drive first." : `Fill in \u201c${title(empty.name)}\u201d: it has no default.`);
    empty.focus();
  }

  // ---- commands
  const wanted = {
    record: () => ({ kind: "record", stand: stand().file, ...fields(form) }),
    stand: () => ({ kind: "doctor", stand: stand().file }),
    identify: () => (picked.length > 1 ? { kind: "compare", recordings: picked } : { kind: "identify", recordings: picked, from: at("from").value, to: at("to").value }),
  };
  // Show the command line that a click on the main button of the step would run, where it is unfolded.
  async function line() {
    const place = document.querySelector(`#${step} .line`);
    if (!place.open) return;
    const found = await ask("/api/line", wanted[step]()).catch((error) => ({ command: plain(error.message) }));
    place.querySelector("code").textContent = found.command;
  }

  async function begin(one) {
    if (moving()) return;
    const moves = one.kind === "record" || one.kind === "doctor" && one.stand !== "sim";
    if (moves && Band.alarmed()) { say("Read the red message first, and say that you have read it."); at("read").focus(); return; }
    began = performance.now();
    clearSaid();
    showReport("");
    at("result").hidden = true;
    if (moves) { clearTimeout(timer); Band.begun(true); }
    const answer = await trying(() => ask("/api/start", one));
    Band.begun(answer && moves ? answer.number : 0);
  }
  async function start() {
    const one = stand(), mine = wanted.record();
    if (one.simulated) { begin(mine); return; }
    const found = await predict(0);
    if (!found || found.refused || JSON.stringify(wanted.record()) !== JSON.stringify(mine)) return;
    announce(engineering(found.amplitude, torqueMode() ? "N m" : "rad"), engineering(found.duration, "s"), { ...mine, yes: true });
  }
  function move() { announce(engineering(stand().limits.torque / 20, "N m"), "3 s", { kind: "doctor", stand: stand().file, move: true, yes: true }); }
  const goesOn = () => at("row").checked && Boolean(stand().next);
  function announce(size, time, command) { question(stand().asked.replace("{size}", size).replace("{time}", time) + (command.move || !goesOn() ? "" : " Then it goes on with the joints after this one."), () => begin(command)); }
  function question(text, agreed) {
    at("asked").textContent = `${text}\nWhile it moves, STOP and any key stop it.`;
    agree = agreed;
    at("question").showModal();
    at("no").focus();
  }

  // ---- what the server tells
  function rows(data) {
    store = store || new Plots.Store(WINDOW * 10000);
    store.add(Plots.unpacked(data));
    if (showsRun) drawing = drawing || requestAnimationFrame(draw);  // not where nothing is new, nor in a hidden tab
  }

  function told(state) {
    showSpace(state.free);
    Band.told(state);
    if (!state.number) return;
    if (!job && state.status !== null) finished = state.number;  // it ended before this page was opened
    else if (!job || job.number !== state.number) {
      store = null;
      if (state.kind === "record") { showsRun = true; zoom(); at("figures").replaceChildren(); plots.torque.clear(); plots.dtheta.clear(); plots.loop.clear(); go("record"); }
    }
    job = state;
    if (job.number === finished && job.status !== null) return;
    const bad = job.status && !job.stops;
    at("said").replaceChildren(...(job.kind === "record" && !job.status || ["design", "identify", "compare"].includes(job.kind) && !bad ? [] : job.said).map((one) => make("li", plain(one), { className: bad ? "error" : "soft" })));
    if (job.kind === "record") showRun();
    if (job.kind === "readings") showReading();
    if (job.kind === "doctor") showChecks();
    if (job.kind === "design" && job.status === null) at("predicted").textContent = plain(job.said[job.said.length - 1] || "searching ...");
    const busy = job.status === null && ["identify", "compare", "export"].includes(job.kind);
    at("progress").hidden = !busy;
    if (busy) at("progress").lastElementChild.textContent = `${plain(job.said[job.said.length - 1] || job.command)} (${Math.round((performance.now() - began) / 1000)} s)`;
    if (job.status !== null && finished !== job.number) { finished = job.number; ended(bad); }
  }

  Band.onChange((moves) => {
    all("[data-still]").forEach((one) => { one.inert = moves; });
    if (!moves) return;
    if (at("question").open) at("question").close();  // STOP must not lie behind it
    if (shownReport) showReport("");  // its frame would take the keys that stop
  }, plain);

  function showRun() {
    const { live } = job;
    at("after").hidden = true;
    at("predicted").textContent = "";
    if (!live) return;
    const [kc, bc] = live.estimate || [null, null], rate = `${live.rate === null ? "\u2013" : live.rate.toFixed(0)} of ${live.planned.toFixed(0)} Hz`;
    pairs(at("figures"), [["Kc so far", engineering(kc, "N m/rad")], ["Bc so far", engineering(bc, "N m s/rad")], ["rate", rate],
      ["late by (99 %)", engineering(live.lateness, "s")], ["late ticks", String(live.late)], ["lost replies", String(live.lost)]]);
  }
  function showReading() {
    const one = job.answer;
    at("reading").hidden = !one;
    if (one) pairs(at("reading"), one.lost ? [["reading", one.lost]] : [["motor", engineering(one.motor, "rad", 4)], ["joint", engineering(one.joint, "rad", 4)], ["torque at the joint", engineering(one.torque, "N m")], ["winding", one.temperature === null ? "\u2013" : `${one.temperature.toFixed(0)} \u00b0C`]]);
  }

  function showChecks() {
    const found = job.answer;
    at("unchecked").hidden = true;
    if (!found) { at("checks").replaceChildren(); return; }
    const lines = found.checks.map((one) => [one.verdict, one.name, one.message]);
    if (found.commissioning) lines.unshift([found.commissioning.ok ? "ok" : "error", "commissioning", found.commissioning.verdict]);
    if (!lines.length) for (const kind of ["serial", "can"]) for (const one of found.ports[kind]) lines.push([one.problem ? "error" : "ok", one.name, one.problem || one.described || "can be used"]);
    if (!lines.length) lines.push(["ok", "simulated stand", "nothing to check; this computer has no serial port and no CAN interface"]);
    at("checks").replaceChildren(...lines.map(([verdict, name, message]) => { const one = make("li", undefined, { className: verdict }); one.append(make("b", verdict), ` ${name}: ${plain(message)}`); return one; }));
  }

  function ended(bad) {
    const asks = job.kind === "doctor" && job.status === 2 && !job.answer && job.command.includes("--commission") && !job.command.includes("--yes");
    const words = job.said.map(Band.bare).filter((one) => !one.startsWith("nothing was driven"));
    if (asks) { question(words.join("\n"), () => begin({ kind: "doctor", stand: stand().file, commission: true, yes: true })); at("said").replaceChildren(); return; }
    if (bad && !job.said.length && !job.answer) say(`hil ${job.kind} ended with status ${job.status} and said nothing${isFull ? ": the disk is full" : ". Run its command line in a terminal, and look whether the disk is full"}.`);
    if (job.kind === "record") { trying(refresh); idleLimits(); }
    if (job.kind === "record" && job.answer && job.answer.recording) {
      output = job.answer.recording;
      at("after").hidden = false;
      at("predicted").textContent = `${output}: ${job.answer.samples} samples, ${job.answer.lost} lost, ${job.answer.late} late (${job.answer.end_reason})`;
      Object.assign(at("to-next"), { hidden: !stand().next, textContent: `Next joint: ${(stand().next || "").split("#").pop()}` });
      if (!job.status && goesOn()) { clicks["to-next"](); begin({ ...wanted.record(), yes: !stand().simulated }); } else if (step === "record") at("to-identify").focus();
    }
    if (job.kind === "stand" && job.status === 0) trying(refresh).then(() => { chooseStand(job.output); showStands(); at("new").open = false; });
    if (job.kind === "design") { at("predicted").textContent = ""; if (job.answer) takeBest(job.answer.profiles.best.profile); }
    if (["identify", "compare"].includes(job.kind)) { if (job.answer) { showResult(job.answer); showReport(job.output); } trying(refresh); }
    if (job.kind === "export" && job.status === 0) Link.address("file", job.output).then((href) => Object.assign(at("exported"), { textContent: `save ${job.output}`, href, hidden: false }));
    line();
  }
  function draw() {
    drawing = 0;
    if (!store || !showsRun) return;
    const { planned: rate, mode } = (job && job.live) || { planned: 500 }, [time, command, torque, dtheta] = store.newest(Math.ceil(WINDOW * rate));
    const byTorque = mode !== "position";
    plots.torque.show(byTorque ? [time, torque, command] : [time, torque], byTorque ? ["torque", "set-point"] : ["torque"]);
    plots.dtheta.show(byTorque ? [time, dtheta] : [time, dtheta, command], byTorque ? ["deflection"] : ["deflection", "set-point"]);
    const few = Math.min(time.length, 4 * plots.loop.width), from = time.length - few;
    plots.loop.show([[dtheta.subarray(from), torque.subarray(from)]]);
  }
  function zoom(low, high) {
    for (const one of [plots.torque, plots.dtheta]) one.zoom(low === undefined ? null : [low, high]);
    at("whole").disabled = low === undefined;
  }

  // ---- the preview of a run
  function predict(wait) {
    clearTimeout(timer);
    at("explained").textContent = table.profiles[form.elements.profile.value] || "";
    if (moving()) return Promise.resolve(null);
    showsRun = false;
    at("after").hidden = true;
    at("predicted").textContent = "predicting ...";
    at("predicted").className = "";
    const mine = predicting = new Promise((done) => { timer = setTimeout(done, wait); })
      .then(() => ask("/api/preview", { stand: stand().file, ...fields(form) })).catch((error) => ({ refused: error.message }))
      .then((found) => { if (mine !== predicting || moving()) return null; showPrediction(found); return found; });
    return mine;
  }

  function showPrediction(found) {
    at("predicted").textContent = plain(found.refused || found.said || `predicted standard errors: Kc ${share(found.errors.Kc)}, Bc ${share(found.errors.Bc)}; amplitude ${engineering(found.amplitude, torqueMode() ? "N m" : "rad")}, ${found.duration} s`);
    at("predicted").className = found.refused ? "error" : "";
    at("rough").open = at("rough").open || Boolean(found.said);
    at("figures").replaceChildren();
    if (found.refused) return;
    const limits = Object.entries(found.limits).map(([name, one]) => [name, one.peak, one.limit, one.unit]);
    if (limits.length) Band.limits(limits, "predicted, in per cent of the limits"); else idleLimits();
    const { time, command, torque, dtheta } = found.curves, isTorque = torqueMode();
    const lines = [...(torque ? [["predicted torque", torque]] : []), ...(isTorque ? [["set-point", command]] : [])];
    zoom();
    if (lines.length) plots.torque.show([time, ...lines.map((one) => one[1])], lines.map((one) => one[0])); else plots.torque.clear();
    if (dtheta || !isTorque) plots.dtheta.show([time, dtheta || command], [dtheta ? "predicted deflection" : "set-point"]); else plots.dtheta.clear();
    if (dtheta) plots.loop.show([[dtheta, torque]]); else plots.loop.clear();
  }
  function takeBest({ kind, mode, amplitude, duration, band_low: low, band_high: high }) {
    fill({ profile: kind, mode, amplitude, duration, band: low === high ? low : `${low}:${high}` });
    predict(0);
    keep();
  }

  // ---- recordings
  function showRecordings() {
    const entries = JSON.stringify(table.recordings);
    if (entries !== at("recordings").listed) at("recordings").replaceChildren(...table.recordings.map((one) => {  // else a click or the focus would be lost
      const row = make("li"), label = make("label");
      label.append(make("input", undefined, { type: "checkbox", value: one.file, ariaLabel: `choose ${one.file}` }), make("b", one.file));
      row.append(label, make("span", one.answer || "not identified", { className: one.answer ? "answer" : "soft" }), make("span", new Date(1000 * one.changed).toLocaleString(), { className: "soft" }));
      if (one.report) row.append(make("button", "Show", { type: "button", ariaLabel: `show the report of ${one.file}`, onclick: () => { at("result").hidden = true; showReport(one.report); } }));
      return row;
    }));
    at("recordings").listed = entries;
    const last = Math.min(first + PAGE, table.count);
    at("count").textContent = table.count ? `${first + 1} to ${last} of ${table.count}, newest first` : "no recording";
    at("no-recording").hidden = table.count > 0 || at("find").value !== "";
    at("newer").disabled = first === 0;
    at("older").disabled = last >= table.count;
    showPicked();
  }

  // The choice is kept apart from the list, which shows only a part of the recordings.
  function pick(names) {
    picked = names;
    showReport("");
    at("result").hidden = at("exported").hidden = true;
    clearSaid();
    showPicked();
    keep();
    trace();
    line();
  }
  function showPicked() {
    all("#recordings input").forEach((one) => { one.checked = picked.includes(one.value); });
    at("picked").replaceChildren(...picked.map((name) => { const one = make("li", name); one.append(make("button", "\u00d7", { type: "button", ariaLabel: `leave out ${name}`, onclick: () => pick(picked.filter((other) => other !== name)) })); return one; }));
    at("do-identify").disabled = picked.length !== 1;
    at("compare").disabled = picked.length < 2;
    at("export").disabled = picked.length !== 1;
  }

  async function trace() {
    const names = picked.slice(0, MOST);
    if (String(names) === traced) return;
    traced = String(names);
    at("from").value = at("to").value = "";
    zoomTrace(null);
    if (!names.length) { plots.trace.clear(); plots.overlay.clear(); return; }
    const found = [];
    for (const name of names) {  // one after the other: a browser has few connections, and STOP needs one
      const data = await ask(`/api/trace?name=${encodeURIComponent(name)}`).catch((error) => { pick(picked.filter((one) => one !== name)); say(error.message); return null; });
      if (!data) { await refresh(); return; }
      found.push(data);
    }
    if (String(names) !== traced) return;
    const frames = found.map(Plots.unpacked).map(({ begin: zero, channels }) => [Float64Array.from(channels[0], (one) => one + zero), channels[2], channels[3]]);
    const lines = frames.map(([time, torque]) => [Array.from(time), Array.from(torque, (one) => (Number.isFinite(one) ? one : null))]);
    plots.trace.show(lines.length === 1 ? lines[0] : uPlot.join(lines, lines.map(() => [0, 1])), names);  // over one time; null where a line has no sample
    plots.overlay.show(frames.map(([, torque, dtheta]) => [dtheta, torque]));
  }

  function chooseWindow(low, high) {
    [at("from").value, at("to").value] = low === undefined ? ["", ""] : [low.toFixed(3), high.toFixed(3)];
    if (low === undefined) zoomTrace(null);
    line();
  }
  function zoomTrace(span) { plots.trace.zoom(span); at("zoom").textContent = span ? "Whole trace" : "Zoom to the window"; }

  // ---- the result: first whether it can be trusted, then the numbers
  function showResult(found) {
    const wrong = found.errors || [], isComparison = job.kind === "compare", good = wrong.length === 0 && !(job.status && !job.stops);
    at("result").hidden = false;
    at("result").className = good ? "good" : "bad";
    at("trust").textContent = isComparison ? (good ? "The recordings agree" : "The recordings do not agree, or a result is missing") : good ? "Kc and Bc can be trusted" : "Not to be trusted";
    pairs(at("values"), isComparison ? [] : ["Kc", "Bc"].filter((name) => found.parameters[name]).map((name) => number(name, found.parameters[name], Math.abs(found.parameters.Kc.value) < 1)));
    const lines = [...wrong.map((one) => ["error", one.message]), ...(found.verdict || []).map((one) => ["", one]), ...(found.warnings || []).map((one) => ["warning", one.message])];
    if (found.model && !isComparison) lines.push(["soft", `${found.recordings.join(", ")}; model ${found.model}; ${found.samples} samples`]);
    at("because").replaceChildren(...lines.map(([kind, text]) => { const one = make("li", undefined, { className: kind }); if (kind === "error" || kind === "warning") one.append(make("b", kind), " "); one.append(plain(text)); return one; }));
  }

  // Return name, value with the half width of its 95 % interval, both rounded to the interval's first digit, and what is to be noted.
  function number(name, { value, unit, ci95: interval, identifiable, trusted }, milli) {
    const half = interval ? (interval[1] - interval[0]) / 2 * (milli ? 1e3 : 1) : NaN, places = half > 0 ? Math.min(12, Math.max(0, -Math.floor(Math.log10(half)))) : 3;
    const text = `${(value * (milli ? 1e3 : 1)).toFixed(places)}${half > 0 ? ` \u00b1 ${half.toFixed(places)}` : ""} ${milli ? "m" : ""}${unit.replaceAll("*", " ")}`;
    return [name, text.replace("-", "\u2212"), !identifiable ? "not identifiable" : trusted ? "95 %" : "not to be trusted"];
  }

  async function showReport(name) {
    const place = at("report"), old = place.querySelector("iframe");
    if (old && document.activeElement === old) at("stop").focus({ preventScroll: true });  // the keys must come to this page
    if (old) old.remove();
    shownReport = moving() ? "" : name;
    place.hidden = !shownReport;
    if (!shownReport) return;
    const src = await Link.address("report", name);
    if (shownReport !== name || place.querySelector("iframe")) return;
    place.append(make("iframe", undefined, { src, title: `report ${name}`, sandbox: "allow-scripts" }));
    (at("result").hidden ? place : at("result")).scrollIntoView({ block: "start" });
  }

  // ---- what a person does
  const find = () => trying(refresh).then(keep);
  const clicks = {
    start, move, write: writeStand, "to-record": () => go("record"), no: () => at("question").close(),
    yes: () => { at("question").close(); agree(); },
    check: () => begin(wanted.stand()), "to-next": () => { chooseStand(stand().next); showStands(); go("record"); },
    readings: () => begin({ kind: "readings", stand: stand().file }),
    design: () => begin({ ...wanted.record(), kind: "design" }),
    commission: () => begin({ kind: "doctor", stand: stand().file, commission: true }),
    "to-identify": async () => { at("find").value = ""; first = 0; pick([output]); go("identify"); begin(wanted.identify()); },
    newer: () => { first = Math.max(0, first - PAGE); find(); }, older: () => { first += PAGE; find(); },
    "do-identify": () => begin(wanted.identify()), compare: () => begin(wanted.identify()), hide: () => showReport(""), "open-report": () => trying(() => Link.openReport(shownReport)), whole: () => zoom(),
    export: () => { at("exported").hidden = true; begin({ kind: "export", recordings: picked, suffix: at("suffix").value }); },
    zoom: () => zoomTrace(plots.trace.span || !at("to").value ? null : [Number(at("from").value), Number(at("to").value)]),
  };
  Object.entries(clicks).forEach(([id, act]) => at(id).addEventListener("click", () => act()));
  all("nav button").forEach((one) => one.addEventListener("click", () => go(one.dataset.step)));
  all(".line").forEach((one) => one.addEventListener("toggle", line));
  all(".copy").forEach((one) => one.addEventListener("click", () => navigator.clipboard.writeText(one.previousElementSibling.textContent).then(() => { one.textContent = "Copied"; setTimeout(() => { one.textContent = "Copy"; }, 1500); }, () => getSelection().selectAllChildren(one.previousElementSibling))));
  at("stands").addEventListener("change", (event) => chooseStand(event.target.value));
  draft.elements.backend.addEventListener("change", () => trying(askAboutDrive));
  form.addEventListener("input", () => { predict(300); keep(); line(); });
  for (const one of [form, draft]) one.addEventListener("submit", (event) => event.preventDefault());
  at("recordings").addEventListener("change", ({ target }) => pick(target.checked ? [...picked, target.value] : picked.filter((name) => name !== target.value)));
  at("find").addEventListener("input", () => { first = 0; later(find); });
  for (const id of ["from", "to"]) at(id).addEventListener("input", line);
  window.addEventListener("popstate", () => { const to = location.hash.slice(1); if (STEPS.includes(to)) go(to, true); else if (to) location.reload(); });  // a new link

  async function enter() {
    const token = location.hash.slice(1), kept = { find: "", picked: [], stand: "sim", first: 0, ...JSON.parse(sessionStorage.getItem(KEPT) || "{}") }, to = STEPS.includes(token) ? token : kept.step || "stand";
    let refused = null;
    ({ picked, first, stand: chosenStand } = kept);
    at("find").value = kept.find;
    if (token && !STEPS.includes(token)) {
      history.replaceState(null, "", location.pathname);
      refused = await Link.enter(token).then(() => null, (error) => error);
    }
    await refresh().catch((error) => { throw refused || error; });  // a browser that is in already needs no link
    fill(kept.form || {});
    history.replaceState(null, "", `#${to}`);
    all("[inert]").forEach((one) => { one.inert = false; });  // no click before there is a stand
    go(to);
    Link.listen({ opened() { store = null; if (Band.opened()) refresh().catch(() => null); }, state: told, rows, closed: Band.closed });
  }
  enter().catch((error) => say(error.message));
})();
