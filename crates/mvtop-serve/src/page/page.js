// The last exposure in all views, the scene, and the history. Nothing but this service is asked.
import { Scene } from "./scene.js";

const POLL_MS = 1000;
const DOUBT = 0.8;

const $ = (id) => document.getElementById(id);
const scene = new Scene($("scene"));
const rigs = new Map(), models = new Map();
let history = [], chosen = null, shown = null, token = sessionStorage.getItem("mvtop-token") || "";

class Refused extends Error {}

/** Asks the service; errors are its own sentences. */
async function ask(path, options = {}) {
  const headers = token ? { Authorization: `Bearer ${token}` } : {};
  const answer = await fetch(path, { ...options, headers });
  if (answer.ok) return answer;
  const told = await answer.json().catch(() => ({}));
  if (answer.status === 401) $("token-form").hidden = false;
  throw new Refused(told.error ? told.error.message : `the service answers ${answer.status}`);
}

const json = async (path) => (await ask(path)).json();

async function known(cache, kind, name) {
  if (!cache.has(name)) cache.set(name, await json(`v1/${kind}/${encodeURIComponent(name)}`));
  return cache.get(name);
}

function say(message) {
  $("message").hidden = !message;
  $("message").textContent = message || "";
}

function element(name, text, attributes = {}) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  Object.assign(made, attributes);
  return made;
}

const percent = (p) => (p === null || p === undefined ? "unknown" : `${(100 * p).toFixed(1)} %`);

async function start() {
  const info = await json("v1/info");
  for (const [id, names] of [["model", info.models], ["rig", info.rigs]]) {
    $(id).replaceChildren(...names.map((name) => element("option", name, { value: name })));
  }
  if (info.ready) {
    await known(models, "models", info.models[0]);
    scene.setRig(await known(rigs, "rigs", info.rigs[0]));
  }
  return info.ready;
}

async function poll() {
  try {
    if (!$("model").options.length) await start();
    const ready = await fetch("readyz").then((answer) => answer.ok);
    $("state").textContent = ready ? "ready" : "loading models";
    $("state").className = ready ? "state ready" : "state";
    const after = history.length ? history[0].number : 0;
    const { exposures } = await json(`v1/exposures?after=${after}`);
    if (exposures.length) {
      history = [...exposures, ...history].slice(0, 100);
      // Of earlier ones the images may be gone meanwhile.
      list();
    }
    const wanted = chosen || (history.length ? history[0].number : null);
    if (wanted && wanted !== shown) await show(wanted);
    $("token-form").hidden = true;
  } catch (error) {
    if (error instanceof Refused) say(error.message);
    else {
      // Numbers begin anew when it is started again.
      [history, chosen, shown] = [[], null, null];
      $("model").replaceChildren();
      $("state").textContent = "no connection";
      $("state").className = "state lost";
    }
  }
  setTimeout(poll, POLL_MS);
}

function look(entry) {
  if (entry.error || !entry.objects) return "bad";
  const doubt = entry.warnings || entry.accepted === false || (entry.least_confidence ?? 1) < DOUBT;
  return doubt ? "doubt" : "";
}

function list() {
  $("history").replaceChildren(...history.map((entry) => {
    const time = new Date(entry.unix_ms).toLocaleTimeString();
    const found = entry.error ? "failed" : `${entry.objects} found, ${percent(entry.least_confidence)}`;
    const button = element("button", `${time} ${found}`, { className: look(entry), title: entry.error || entry.request_id });
    button.setAttribute("aria-current", entry.number === shown);
    button.onclick = () => {
      chosen = entry.number;
      $("live").hidden = false;
      show(entry.number).catch((error) => say(error.message));
    };
    const item = element("li");
    item.append(button);
    return item;
  }));
}

async function show(number) {
  const exposure = await json(`v1/exposures/${number}`);
  const [rig, model] = [await known(rigs, "rigs", exposure.rig), await known(models, "models", exposure.model)];
  shown = number;
  list();
  say(exposure.error);
  const objects = exposure.answer ? exposure.answer.objects : [];
  const took = `exposure ${number}, ${exposure.model}, ${exposure.rig}, ${exposure.took_ms.toFixed(0)} ms`;
  $("about").textContent = exposure.error ? took : `${took}; ${objects.length} found`;
  const warnings = exposure.answer ? exposure.answer.warnings : [];
  const misses = (exposure.answer && exposure.answer.why) || [];
  $("warnings").replaceChildren(...[...warnings, ...misses].map((one) => element("li", one.message)));
  table(objects);
  scene.setRig(rig);
  scene.setObjects(objects.map((object) => {
    const about = model.classes.find((one) => one.name === object.class) || { points: [], diameter_m: 0.1 };
    return { name: object.class, pose: object.T_world_obj, points: about.points, diameter: about.diameter_m };
  }));
  const cameras = rig.cameras.filter((camera) => exposure.cameras.includes(camera.id));
  const figures = await Promise.all(cameras.map((camera) => view(number, camera)));
  if (shown !== number) return;
  $("views").replaceChildren(...figures);
  if (!figures.length) $("views").append(element("p", "Its images are no longer in memory.", { className: "hint" }));
}

/** A camera's picture, with the objects as the service draws them. */
async function view(number, camera) {
  const figure = element("figure");
  const canvas = element("canvas");
  figure.append(canvas, element("figcaption", camera.id));
  let picture;
  try {
    const path = `v1/exposures/${number}/views/${encodeURIComponent(camera.id)}`;
    picture = await createImageBitmap(await (await ask(path)).blob());
  } catch (error) {
    figure.append(element("p", error.message, { className: "hint" }));
    return figure;
  }
  [canvas.width, canvas.height] = [picture.width, picture.height];
  canvas.getContext("2d").drawImage(picture, 0, 0);
  return figure;
}

function table(objects) {
  $("objects").hidden = !objects.length;
  $("objects").tBodies[0].replaceChildren(...objects.map((object) => {
    const row = element("tr");
    const at = object.T_world_obj.slice(0, 3).map((r) => (1000 * r[3]).toFixed(1)).join(", ");
    const error = `${object.sigma.rot_deg.toFixed(1)}°, ${(1000 * object.sigma.t_m).toFixed(1)} mm`;
    const sure = object.verdict ? `${percent(object.confidence)}, ${object.verdict}` : percent(object.confidence);
    row.append(...[object.class, sure, error, at].map((text) => element("td", text)));
    return row;
  }));
}

/** Sends images: those named after cameras are of these, else the rig's order counts. */
async function send(files) {
  say("");
  const rig = await known(rigs, "rigs", $("rig").value);
  const ids = rig.cameras.map((camera) => camera.id);
  const stem = (file) => file.name.replace(/\.[^.]*$/, "");
  const sorted = files.sort((a, b) => a.name.localeCompare(b.name));
  const named = sorted.some((file) => ids.includes(stem(file)));
  const form = new FormData();
  sorted.forEach((file, i) => form.append(named ? stem(file) : ids[i] || stem(file), file));
  const query = new URLSearchParams({ model: $("model").value, rig: $("rig").value });
  chosen = null;
  $("live").hidden = true;
  await ask(`v1/predict?${query}`, { method: "POST", body: form });
}

/** A browser empties its list of files as soon as the field is, so it is copied. */
const sent = (files) => files.length && send([...files]).catch((error) => say(error.message));

$("files").onchange = (e) => {
  sent(e.target.files);
  e.target.value = "";
};
$("live").onclick = () => {
  chosen = null;
  $("live").hidden = true;
};
$("token-form").onsubmit = (e) => {
  e.preventDefault();
  token = $("token").value;
  sessionStorage.setItem("mvtop-token", token);
  say("");
};
document.addEventListener("dragover", (e) => {
  e.preventDefault();
  document.body.classList.add("over");
});
document.addEventListener("dragleave", () => document.body.classList.remove("over"));
document.addEventListener("drop", (e) => {
  e.preventDefault();
  document.body.classList.remove("over");
  sent(e.dataTransfer.files);
});
poll();
