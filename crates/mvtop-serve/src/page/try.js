// A form for POST /v1/predict.
const $ = (id) => document.getElementById(id);
$("token").value = sessionStorage.getItem("mvtop-token") || "";
const headers = () => ($("token").value ? { Authorization: `Bearer ${$("token").value}` } : {});
const json = async (path) => (await fetch(path, { headers: headers() })).json();

async function cameras() {
  const info = await json("v1/info");
  if (info.error) throw new Error(info.error.message);
  const rig = await json(`v1/rigs/${encodeURIComponent(info.rigs[0])}`);
  $("cameras").replaceChildren(...rig.cameras.map((camera) => {
    const label = document.createElement("label");
    const input = Object.assign(document.createElement("input"), { type: "file", accept: "image/*" });
    input.dataset.camera = camera.id;
    label.append(`${camera.id} `, input);
    return label;
  }));
}

$("send").onclick = async () => {
  const form = new FormData();
  if ($("request").value) form.append("request", $("request").value);
  for (const input of document.querySelectorAll("[data-camera]")) {
    if (input.files.length) form.append(input.dataset.camera, input.files[0]);
  }
  $("answer").textContent = "...";
  try {
    const options = { method: "POST", body: form, headers: headers() };
    const answer = await fetch(`v1/predict?${$("query").value}`, options);
    const lines = ["x-request-id", "retry-after"].map((name) => [name, answer.headers.get(name)]);
    const head = lines.filter(([, value]) => value).map(([name, value]) => `${name}: ${value}`);
    $("answer").textContent = [`${answer.status} ${answer.statusText}`, ...head, "", await answer.text()].join("\n");
  } catch (error) {
    $("answer").textContent = String(error);
  }
};

const listed = () => cameras().catch((error) => { $("answer").textContent = error.message; });
$("token").onchange = listed;
listed();
