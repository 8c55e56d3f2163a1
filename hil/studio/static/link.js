"use strict";
// The one place where the page talks to its server: entry with the link's token, requests, the stream, STOP, and addresses of files.
// The key lives in this window's sessionStorage, and never in a cookie, which a browser would send to every port of the computer.
const Link = (function () {
  const KEY = "hil-studio-key";
  let socket = null, pressed = new Map();

  function request(path, method, body, more) {
    const headers = { authorization: `Bearer ${sessionStorage.getItem(KEY) || ""}`, "content-type": "application/json" };
    return fetch(path, { method, body, headers, ...more });
  }

  // Return the server's answer: an object, or bytes. sent: an object to POST, undefined for a GET. Throws an Error with the reason of a refusal.
  async function ask(path, sent) {
    const answer = await request(path, sent === undefined ? "GET" : "POST", sent === undefined ? undefined : JSON.stringify(sent));
    const isJson = (answer.headers.get("content-type") || "").startsWith("application/json");
    const given = isJson ? await answer.json() : answer.ok ? await answer.arrayBuffer() : { refused: await answer.text() };
    if (!answer.ok) throw new Error(given.refused || `the server answered ${answer.status}`);
    return given;
  }

  // Admit this window with the token of the link. Throws an Error if the token is refused.
  async function enter(token) { sessionStorage.setItem(KEY, (await ask("/token", { token })).key); }

  // Open the stream, again 1 s after each end of it. on: {opened(), state(object), rows(ArrayBuffer), closed()}.
  function listen(on) {
    socket = new WebSocket(`ws://${location.host}/api/stream`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { socket.send(sessionStorage.getItem(KEY) || ""); on.opened(); };
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string") { on.rows(data); return; }
      const given = JSON.parse(data), heard = pressed.get(given.press);
      if (heard) heard(given);
      else if (given.number !== undefined) on.state(given);
    };
    socket.onclose = () => { on.closed(); setTimeout(() => listen(on), 1000); };
  }

  // Send STOP in two ways, since the open stream is faster and the request goes where the stream hangs. Return the first answer that names this press, {press, running}.
  async function stop() {
    const press = String(Math.random()), heard = new Promise((resolve) => { pressed = new Map([[press, resolve]]); });
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(press);
    const asked = request(`/api/stop?press=${press}`, "POST", undefined, { keepalive: true }).then((answer) => {
      if (!answer.ok) throw new Error(`the server answered ${answer.status}`);
      return answer.json();
    });
    return Promise.race([asked, heard]);
  }

  // Return an address of a file of the folder for a frame ("report") or a download ("file"). kind: "report" or "file".
  async function address(kind, name) { return (await ask(`/api/ticket?kind=${kind}&name=${encodeURIComponent(name)}`)).address; }

  // Show a report in a window of its own: in a frame, whose empty page allows no other address, so that the report can send nothing away.
  async function openReport(name) {
    const shown = window.open("", "_blank"), frame = shown.document.createElement("iframe");
    Object.assign(frame, { title: `report ${name}`, sandbox: "allow-scripts", src: await address("report", name) });
    Object.assign(frame.style, { position: "fixed", inset: "0", width: "100%", height: "100%", border: "0" });
    shown.document.title = name;
    shown.document.body.append(frame);
  }

  return { ask, enter, listen, stop, address, openReport };
})();
