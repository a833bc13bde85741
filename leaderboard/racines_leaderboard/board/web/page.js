"use strict";
const told = JSON.parse(document.getElementById("content").textContent).sections;
const all = (query, where = document) => [...where.querySelectorAll(query)];
const get = id => document.getElementById(id);
const make = (name, words, values = {}) => {
  const made = document.createElement(name);
  made.textContent = words;
  for (const [key, value] of Object.entries(values)) made.setAttribute(key, value);
  return made;
};

// Boards as tabs: arrows, Home and End move between them.
const tabs = all("#tabs a"), boards = all(".board");
const open = (tab, focus) => {
  for (const each of tabs) {
    const chosen = each === tab;
    each.setAttribute("aria-selected", chosen);
    each.tabIndex = chosen ? 0 : -1;
    get(each.hash.slice(1)).hidden = !chosen;
  }
  if (focus) tab.focus();
  tab.scrollIntoView({block: "nearest", inline: "nearest"});
};
get("tabs").setAttribute("role", "tablist");
for (const board of boards) {
  board.setAttribute("role", "tabpanel");
  board.setAttribute("aria-labelledby", "tab-" + board.id);
}
tabs.forEach((tab, number) => {
  tab.setAttribute("role", "tab");
  tab.setAttribute("aria-controls", tab.hash.slice(1));
  tab.addEventListener("click", event => {
    event.preventDefault();
    open(tab, false);
    history.replaceState(null, "", tab.hash);
  });
  tab.addEventListener("keydown", event => {
    const to = {ArrowRight: number + 1, ArrowLeft: number - 1, Home: 0, End: tabs.length - 1}[event.key];
    if (to === undefined) return;
    event.preventDefault();
    open(tabs[(to + tabs.length) % tabs.length], true);
  });
});
const follow = () => {
  const target = get(location.hash.slice(1));
  const board = target && target.closest(".board");
  open(board ? get("tab-" + board.id) : tabs[0], false);
  const about = target && target.closest("details");
  if (about) { about.open = true; target.scrollIntoView({block: "center"}); }
};
addEventListener("hashchange", follow);
follow();

// Sorting: what has no number stands last in either direction.
const valueOf = (row, column) => {
  const cell = row.cells[column];
  if (cell.dataset.v !== undefined) return Number(cell.dataset.v);
  const words = cell.textContent.trim();
  return cell.matches(".f, .n, .place") || words === "–" ? null : words;
};
const sort = (table, column) => {
  const heads = all("thead th", table), head = heads[column];
  const down = head.getAttribute("aria-sort") === "ascending";
  for (const each of heads) each.setAttribute("aria-sort", "none");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const body = table.tBodies[0], sign = down ? -1 : 1;
  const rows = [...body.rows].map(row => [valueOf(row, column), row]);
  rows.sort(([a], [b]) => {
    if (a === null || b === null) return (a === null) - (b === null);
    return sign * (typeof a === "number" && typeof b === "number" ? a - b
      : String(a).localeCompare(String(b), "en", {numeric: true}));
  });
  body.append(...rows.map(([, row]) => row));
};
for (const table of all("table")) {
  all("thead th", table).forEach((head, column) => {
    const button = make("button", head.textContent, {type: "button"});
    head.replaceChildren(button);
    head.setAttribute("aria-sort", "none");
    button.addEventListener("click", () => sort(table, column));
  });
}

// Filters
const filters = get("filters");
filters.hidden = false;
const apply = () => {
  const words = get("f-text").value.trim().toLowerCase(), kind = get("f-kind").value;
  const few = Number(get("f-trainings").value), verdict = get("f-verdict").value;
  for (const ranking of all(".ranking")) {
    let shown = 0;
    for (const row of ranking.querySelector("tbody").rows) {
      const said = (row.querySelector(".name").textContent + " " + row.dataset.text).toLowerCase();
      const count = Number(row.dataset.trainings);
      const passes = said.includes(words) && (!kind || row.dataset.kind === kind)
        && (!few || (few > 0 ? count >= few : count < -few))
        && (!verdict || row.dataset.verdict === verdict);
      row.hidden = !passes;
      shown += passes;
    }
    ranking.querySelector(".empty").hidden = shown > 0;
  }
};
filters.addEventListener("input", apply);
filters.addEventListener("reset", () => setTimeout(apply));
filters.addEventListener("submit", event => event.preventDefault());

// Two rows compared: the paired difference, as the ranking computes it.
const svg = (name, values) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(values)) made.setAttribute(key, value);
  return made;
};
const drawn = pair => {
  const most = Math.max(Math.abs(pair.low), Math.abs(pair.high), 0.05) * 1.1;
  const x = value => 230 + 220 * value / most;
  const made = svg("svg", {viewBox: "0 0 460 46", "aria-hidden": "true"});
  made.append(
    svg("path", {class: "a", d: "M10 16H450"}),
    svg("path", {class: "z", d: "M230 4V28"}),
    svg("path", {class: "r", d: "M" + x(pair.low) + " 16H" + x(pair.high)}),
    svg("circle", {cx: x(pair.value), cy: 16, r: 5}));
  for (const value of [-most / 1.1, 0, most / 1.1]) {
    const words = svg("text", {x: x(value), y: 42, "text-anchor": "middle"});
    words.textContent = value ? value.toFixed(2) : "0, no difference";
    made.append(words);
  }
  return made;
};
for (const ranking of all(".ranking")) {
  const {names, pairs} = told[ranking.dataset.key], box = ranking.querySelector(".compare");
  const picked = [];
  [...ranking.querySelector("tbody").rows].forEach((row, number) => {
    const tick = make("input", "", {type: "checkbox", "aria-label": "Compare " + names[number]});
    row.querySelector(".name").prepend(tick);
    const entry = {row, number, tick};
    tick.addEventListener("change", () => {
      if (tick.checked) picked.push(entry); else picked.splice(picked.indexOf(entry), 1);
      if (picked.length > 2) picked.shift().tick.checked = false;
      for (const each of ranking.querySelectorAll("tbody tr")) {
        each.classList.toggle("picked", picked.some(one => one.row === each));
      }
      box.replaceChildren();
      if (picked.length === 1) box.append(make("p", "Tick a second row to compare."));
      if (picked.length < 2) return;
      const [i, j] = picked.map(one => one.number).sort((a, b) => a - b);
      const pair = pairs.find(one => one.rows[0] === i && one.rows[1] === j);
      box.append(make("p", pair.text));
      if (typeof pair.low === "number" && typeof pair.high === "number") box.append(drawn(pair));
    });
  });
}
