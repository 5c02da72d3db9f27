// The page of a run: it shows Rerun's viewer, asks for the run's state once a second, and sends commands.
"use strict";
const query = new URLSearchParams(location.search), token = query.get("token");
const find = (id) => document.getElementById(id);
const headers = { "X-Murmur-Token": token };

const theme = query.get("theme") || (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
document.documentElement.classList.toggle("light", theme === "light");

const viewer = new URLSearchParams({ url: `rerun+http://${location.host}/proxy`, hide_welcome_screen: "1", theme });
for (const name of ["persist", "renderer"]) {
  if (query.has(name)) viewer.set(name, query.get(name));
}
find("viewer").src = `viewer/?${viewer}`;

let paused = false;

function tell(text, isError = false) {
  find("message").value = text;
  find("message").classList.toggle("error", isError);
}

function show(state) {
  const hasRun = "step" in state;
  find("bar").hidden = !hasRun;
  if (!hasRun) return;
  paused = state.paused;
  find("step").value = `step ${state.step}` + (state.ended ? ", ended" : paused ? ", paused" : "");
  find("speed").value = state.speed ? `${state.speed} step${state.speed === 1 ? "" : "s"}/s` : "unlimited";
  find("pause").textContent = paused ? "Resume" : "Pause";
  for (const part of ["pace", "faults", "radio"]) {
    find(part).hidden = !state.controls;
    find(part).disabled = state.ended;
  }
  const robots = find("robot");
  for (let robot = robots.length; robot < state.robots; robot++) robots.add(new Option(`robot ${robot}`, robot));
}

async function update() {
  try {
    const answer = await fetch("state", { headers });
    if (answer.ok) show(await answer.json());
    if (find("message").dataset.lost) tell("");
    delete find("message").dataset.lost;
  } catch {
    find("message").dataset.lost = "1";
    tell("Murmur has ended", true);
  }
}

async function send(command, value = "") {
  try {
    const body = JSON.stringify({ command, value });
    const answer = await fetch("command", { method: "POST", headers, body });
    const content = await answer.json();
    tell(content.message || content.error, !answer.ok);
  } catch (error) {
    tell(`not sent: ${error.message}`, true);
  }
  update();
}

find("bar").addEventListener("submit", (event) => event.preventDefault());
find("pause").addEventListener("click", () => send(paused ? "resume" : "pause"));
for (const button of document.querySelectorAll("button[data-command]")) {
  const field = button.dataset.value && find(button.dataset.value);
  button.addEventListener("click", () => send(button.dataset.command, field ? field.value : ""));
  if (field && field.tagName === "INPUT") {
    field.addEventListener("keydown", (event) => {
      if (event.key === "Enter") button.click();
    });
  }
}
update();
setInterval(update, 1000);
