"use strict";
// The editor of a site: a map on a canvas, and a problem whose text is kept in step with it.
// The text of the problem is the one truth: what is clicked changes it, what is typed is drawn.

const TYPE = {footprint: [0.8, 0.6], model: "diff"};   // of robots, until the problem says another
const MAP_KEYS = ["negate", "occupied_thresh", "free_thresh"];

class Editor {
  constructor(canvas, text, frame, say) {
    this.canvas = canvas; this.text = text; this.frame = frame; this.say = say;
    this.picture = null; this.image = ""; this.more = {}; this.cells = null;
    this.tool = "look"; this.from = null; this.pickup = null;
    canvas.addEventListener("pointerdown", e => { this.from = this.world(e); canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointerup", e => { const from = this.from; this.from = null; if (from) this.act(from, this.world(e)); });
    canvas.addEventListener("pointermove", e => this.point(this.world(e)));
    text.addEventListener("input", () => this.draw());
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // -- the map ---------------------------------------------------------------------------------
  async open(file) {                       // a PNG or PGM
    const bytes = new Uint8Array(await file.arrayBuffer());
    this.cells = null;
    this.image = await encoded(bytes);
    this.picture = bytes[0] === 0x50 ? grey(...parsed(bytes)) : await createImageBitmap(new Blob([bytes]));
    this.shown();
  }

  async blank(width, height) {             // a hall with walls around, m; cells as said
    const {resolution} = this.frame(), columns = Math.round(width / resolution), rows = Math.round(height / resolution);
    if (!(columns > 4 && rows > 4 && columns * rows <= 4e6)) { this.say("a floor of 5 to 4,000,000 cells, please"); return; }
    this.cells = {columns, rows, values: new Uint8Array(columns * rows).fill(254)};
    const thick = Math.max(1, Math.round(0.2 / resolution));
    for (const [x, y, w, h] of [[0, 0, columns, thick], [0, rows - thick, columns, thick], [0, 0, thick, rows], [columns - thick, 0, thick, rows]]) this.fill(x, y, w, h);
    await this.written();
  }

  fill(left, top, width, height) {
    const {columns, rows, values} = this.cells;
    for (let y = Math.max(0, top); y < Math.min(rows, top + height); y++)
      values.fill(0, y * columns + Math.max(0, left), y * columns + Math.min(columns, left + width));
  }

  async written() {                        // the cells as a PGM, and as a picture
    const {columns, rows, values} = this.cells;
    const head = new TextEncoder().encode(`P5\n${columns} ${rows}\n255\n`);
    this.image = await encoded(new Uint8Array([...head, ...values]));
    this.picture = grey(columns, rows, values);
    this.shown();
  }

  shown() { this.canvas.hidden = false; this.draw(); }

  async wall(a, b) {
    if (!this.cells) { this.say("walls are drawn on a new floor"); return; }
    const [u, v] = this.pixel(a), [p, q] = this.pixel(b);
    const left = Math.floor(Math.min(u, p)), top = Math.floor(Math.min(v, q));
    this.fill(left, top, Math.max(2, Math.ceil(Math.abs(u - p))), Math.max(2, Math.ceil(Math.abs(v - q))));
    await this.written();
  }

  // -- where things are: cells of the picture, and metres of the world --------------------------
  pixel([x, y]) {
    const {resolution, origin: [ox, oy, yaw]} = this.frame(), c = Math.cos(yaw), s = Math.sin(yaw);
    const u = (c * (x - ox) + s * (y - oy)) / resolution, v = (c * (y - oy) - s * (x - ox)) / resolution;
    return [u, this.picture.height - v];
  }

  world(event) {
    if (!this.picture) return [0, 0];
    const box = this.canvas.getBoundingClientRect(), scale = this.picture.width / box.width;
    const {resolution, origin: [ox, oy, yaw]} = this.frame(), c = Math.cos(yaw), s = Math.sin(yaw);
    const u = (event.clientX - box.left) * scale * resolution;
    const v = (this.picture.height - (event.clientY - box.top) * scale) * resolution;
    return [ox + c * u - s * v, oy + s * u + c * v];
  }

  // -- the problem -----------------------------------------------------------------------------
  problem() {                              // as an object; null where the text is none (YAML is not)
    if (!this.text.value.trim()) return {};
    try { const told = JSON.parse(this.text.value); return told && typeof told === "object" && !Array.isArray(told) ? told : null; }
    catch { return null; }
  }

  keep(problem) { this.text.value = pretty(problem); this.draw(); }

  async act(from, to) {
    if (this.tool === "wall") { await this.wall(from, to); return; }
    if (this.tool === "look") return;
    const problem = this.problem();
    if (problem === null) { this.say("clicks change problems that are JSON; this text is not (or not yet)"); return; }
    this.say("");
    ({place: addPlace, robot: addRobot, order: (p, at) => this.order(p, at), remove: (p, at) => remove(p, this.near(p, at))})[this.tool](problem, from, heading(from, to));
    this.keep(problem);
  }

  order(problem, at) {                     // two clicks: where it is fetched, where it goes
    const [kind, name] = this.near(problem, at);
    if (kind !== "places") { this.say("an order leads from one place to another: click a place"); return; }
    if (this.pickup === null || this.pickup === name || !(this.pickup in problem.places)) { this.pickup = name; this.say(`from ${name} to ...`); return; }
    const orders = problem.orders ||= [];
    if (!Array.isArray(orders)) { this.say("the orders are in a table beside the problem"); return; }
    orders.push({id: fresh("o", orders.map(o => o.id)), pickup: this.pickup, delivery: name});
    this.pickup = null;
  }

  near(problem, [x, y]) {                  // [kind, name] of what is nearest, within 0.8 m
    const found = [["", ""]];
    let least = 0.8;
    for (const [kind, name, pose] of poses(problem)) {
      const far = Math.hypot(pose[0] - x, pose[1] - y);
      if (far < least) { least = far; found[0] = [kind, name]; }
    }
    return found[0];
  }

  // -- what is seen ----------------------------------------------------------------------------
  point(at) { this.canvas.title = this.picture ? `${round(at[0])}, ${round(at[1])}` : ""; }

  draw() {
    if (!this.picture || this.canvas.hidden) return;
    const box = this.canvas.getBoundingClientRect(), ratio = devicePixelRatio || 1;
    this.canvas.style.aspectRatio = `${this.picture.width} / ${this.picture.height}`;
    this.canvas.width = Math.max(1, box.width * ratio); this.canvas.height = this.canvas.width * this.picture.height / this.picture.width;
    const g = this.canvas.getContext("2d"), scale = this.canvas.width / this.picture.width;
    g.imageSmoothingEnabled = false;
    g.drawImage(this.picture, 0, 0, this.canvas.width, this.canvas.height);
    g.scale(scale, scale);
    const pen = {g, at: p => this.pixel(p), metre: 1 / this.frame().resolution, dot: ratio / scale};
    const problem = this.problem();
    if (problem !== null) paint(pen, problem);
  }
}

// -- the problem, changed ------------------------------------------------------------------------
function addPlace(problem, [x, y], theta) {
  const places = problem.places ||= {};
  places[fresh("p", names(problem))] = [round(x), round(y), theta];
}

function addRobot(problem, [x, y], theta) {
  const types = problem.robot_types ||= {};
  if (!Object.keys(types).length) types.agv = {...TYPE};
  (problem.robots ||= {})[fresh("r", names(problem))] = {type: Object.keys(types)[0], start: [round(x), round(y), theta]};
}

function remove(problem, [kind, name]) {   // and the orders to and from a place
  if (!kind) return;
  delete problem[kind][name];
  if (kind === "places" && Array.isArray(problem.orders))
    problem.orders = problem.orders.filter(o => ![stops(o.pickup), stops(o.delivery)].flat().includes(name));
}

function names(problem) {
  return ["robot_types", "robots", "places", "doors", "automatic_doors", "zones", "lanes", "resources", "lifts", "floors"].flatMap(k => Object.keys(problem[k] || {}));
}

function fresh(letter, taken) {
  let number = 1;
  while (taken.includes(letter + number)) number++;
  return letter + number;
}

function heading([x, y], [u, v]) {         // of a drag; a click looks along x
  return Math.hypot(u - x, v - y) < 0.3 ? 0 : Math.round(100 * Math.atan2(v - y, u - x)) / 100;
}

function round(metres) { return Math.round(20 * metres) / 20; }

// -- the problem, read and drawn -----------------------------------------------------------------
function stops(stop) { return [stop && typeof stop === "object" && !Array.isArray(stop) ? stop.at || [] : stop || []].flat(); }

function* poses(problem) {                 // yields [kind, name, pose]
  for (const [name, place] of Object.entries(problem.places || {})) {
    const pose = Array.isArray(place) ? place : place && place.pose;
    if (isPose(pose)) yield ["places", name, pose];
  }
  for (const [name, robot] of Object.entries(problem.robots || {}))
    if (robot && isPose(robot.start)) yield ["robots", name, robot.start];
}

function isPose(pose) { return Array.isArray(pose) && pose.length === 3 && pose.every(Number.isFinite); }

function paint(pen, problem) {
  const {g, at, metre, dot} = pen, where = {};
  for (const kind of ["zones", "automatic_doors"])
    for (const area of Object.values(problem[kind] || {})) outline(pen, area && area.polygon, kind === "zones" ? "#b3261e" : "#616e7c");
  for (const [kind, name, pose] of poses(problem)) if (kind === "places") where[name] = pose;
  for (const order of Array.isArray(problem.orders) ? problem.orders : [])
    for (const a of stops(order && order.pickup)) for (const b of stops(order && order.delivery)) if (where[a] && where[b]) arrow(pen, where[a], where[b]);
  for (const [kind, name, pose] of poses(problem)) {
    const [u, v] = at(pose), tip = at([pose[0] + 0.5 * Math.cos(pose[2]), pose[1] + 0.5 * Math.sin(pose[2])]);
    const color = kind === "robots" ? "#d55e00" : "#0072b2";
    if (kind === "robots") outline(pen, body(problem, name, pose), color, true);
    g.strokeStyle = g.fillStyle = color; g.lineWidth = 2 * dot;
    g.beginPath(); g.arc(u, v, 4 * dot, 0, 7); g.fill();
    g.beginPath(); g.moveTo(u, v); g.lineTo(...tip); g.stroke();
    g.font = `${12 * dot}px system-ui, "DejaVu Sans", sans-serif`; g.fillStyle = "#1f2933";
    g.fillText(name, u + 6 * dot, v - 6 * dot);
  }
}

function body(problem, robot, [x, y, theta]) {
  const type = (problem.robot_types || {})[problem.robots[robot].type] || TYPE;
  const [l, w] = type.footprint || TYPE.footprint, c = Math.cos(theta), s = Math.sin(theta);
  const corners = Array.isArray(l) ? type.footprint : [[-l, -w], [l, -w], [l, w], [-l, w]].map(([a, b]) => [a / 2, b / 2]);
  return corners.map(([a, b]) => [x + c * a - s * b, y + s * a + c * b]);
}

function outline({g, at, dot}, corners, color, full = false) {
  if (!Array.isArray(corners) || corners.length < 3) return;
  g.beginPath();
  for (const corner of corners) g.lineTo(...at(corner));
  g.closePath(); g.strokeStyle = color; g.lineWidth = 1.5 * dot; g.stroke();
  g.globalAlpha = full ? 0.6 : 0.15; g.fillStyle = color; g.fill(); g.globalAlpha = 1;
}

function arrow({g, at, dot}, from, to) {
  const [u, v] = at(from), [p, q] = at(to), turn = Math.atan2(q - v, p - u);
  g.strokeStyle = "#009e73"; g.lineWidth = 1.5 * dot;
  g.beginPath(); g.moveTo(u, v); g.lineTo(p, q);
  for (const side of [2.7, -2.7]) { g.moveTo(p, q); g.lineTo(p + 9 * dot * Math.cos(turn + side), q + 9 * dot * Math.sin(turn + side)); }
  g.stroke();
}

function pretty(problem) {                 // JSON with a thing a line
  const told = Object.entries(problem).map(([key, value]) => {
    if (!value || typeof value !== "object") return ` ${JSON.stringify(key)}: ${JSON.stringify(value)}`;
    const listed = Array.isArray(value), [open, close] = listed ? "[]" : "{}";
    const items = listed ? value.map(plain) : Object.entries(value).map(([k, v]) => `${JSON.stringify(k)}: ${plain(v)}`);
    return ` ${JSON.stringify(key)}: ${open}${items.map(i => "\n  " + i).join(",")}${items.length ? "\n " : ""}${close}`;
  });
  return `{\n${told.join(",\n")}\n}\n`;
}

function plain(value) {                    // on one line, with spaces outside of names and texts
  if (Array.isArray(value)) return `[${value.map(plain).join(", ")}]`;
  if (value && typeof value === "object") return `{${Object.entries(value).map(([k, v]) => `${JSON.stringify(k)}: ${plain(v)}`).join(", ")}}`;
  return JSON.stringify(value);
}

// -- pictures ------------------------------------------------------------------------------------
function encoded(bytes) {                  // as a data URL
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onload = () => resolve(reader.result);
    reader.onerror = () => reject(reader.error);
    reader.readAsDataURL(new Blob([bytes]));
  });
}

function grey(columns, rows, values) {
  const canvas = document.createElement("canvas");
  canvas.width = columns; canvas.height = rows;
  const g = canvas.getContext("2d"), data = g.createImageData(columns, rows);
  for (let i = 0; i < columns * rows; i++) data.data.set([values[i], values[i], values[i], 255], 4 * i);
  g.putImageData(data, 0, 0);
  return canvas;
}

function parsed(bytes) {                   // a PGM (P2, P5), of one byte a cell: [columns, rows, values]
  const words = [];
  let i = 0;
  while (words.length < 4) {
    while (/\s/.test(String.fromCharCode(bytes[i]))) i++;
    if (i >= bytes.length) throw new Error("the PGM ends in its head");
    if (bytes[i] === 0x23) { while (i < bytes.length && bytes[i] !== 0x0a) i++; continue; }
    let word = "";
    while (i < bytes.length && !/\s/.test(String.fromCharCode(bytes[i]))) word += String.fromCharCode(bytes[i++]);
    words.push(word);
  }
  const [kind, columns, rows, most] = [words[0], ...words.slice(1).map(Number)];
  const rest = bytes.subarray(i + 1);
  const values = kind === "P5" ? rest : new TextDecoder().decode(rest).trim().split(/\s+/).map(Number);
  if (!(columns > 0 && rows > 0 && most > 0 && most < 256 && values.length >= columns * rows)) throw new Error("this PGM cannot be shown");
  return [columns, rows, most === 255 ? values : Array.from(values, v => 255 * v / most)];
}

function saidOfMap(text) {                 // what a map_server file says: {resolution, origin, ...}
  const said = {};
  for (const [, key, value] of text.matchAll(/^\s*(\w+)\s*:\s*([^#\n]*)/gm)) {
    if (key === "origin") said.origin = value.replace(/[[\]]/g, "").split(",").map(Number);
    else if (key === "resolution" || MAP_KEYS.includes(key)) said[key] = Number(value);
  }
  return said;
}
