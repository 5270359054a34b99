// Menus for scenario and seed, and a box for each controller: what an oscilloscope or a map of kerfs shows.
class Chooser {
  constructor(element, changed) {
    const data = JSON.parse(element.querySelector("script[type='application/json']").textContent);
    Object.assign(this, data, { element, changed: () => {} });
    this.menus = ["scenario", "seed"].map(name => element.querySelector(`select[name=${name}]`));
    this.boxes = element.querySelector(".boxes");
    for (const g of data.groups) {
      const option = document.createElement("optgroup");
      option.label = g.suite;
      g.scenarios.forEach((s, i) => option.append(new Option(s.name, data.groups.indexOf(g) + ":" + i)));
      this.menus[0].append(option);
    }
    this.menus[0].value = this.first;
    this.menus[0].addEventListener("change", () => this.pick());
    this.menus[1].addEventListener("change", () => this.seed());
    this.pick();
    this.changed = changed;
  }
  pick() {
    const [g, s] = this.menus[0].value.split(":").map(Number);
    if (this.group !== this.groups[g]) this.chosen = new Set(this.groups[g].chosen);
    this.group = this.groups[g];
    this.scenario = this.group.scenarios[s];
    this.element.querySelector(".about").textContent = this.scenario.summary;
    this.menus[1].replaceChildren(...this.scenario.seeds.map(r => new Option(r.seed, r.seed)));
    this.seed();
  }
  seed() {
    this.run = this.scenario.seeds[this.menus[1].selectedIndex];
    this.boxes.replaceChildren(...this.there().map(name => this.box(name)));
    this.changed(true);
  }
  // Controllers of the run, in order of rank.
  there() { return this.group.order.filter(name => name in this.run.controllers); }
  names() { return this.there().filter(name => this.chosen.has(name)); }
  box(name) {
    const label = document.createElement("label"), box = document.createElement("input"), swatch = document.createElement("i");
    const [colour, dash] = this.looks[name];
    box.type = "checkbox";
    box.value = name;
    box.checked = this.chosen.has(name);
    box.addEventListener("change", () => { this.chosen[box.checked ? "add" : "delete"](name); this.changed(false); });
    swatch.style.borderTop = `3px ${{ solid: "solid", dot: "dotted" }[dash] || "dashed"} ${colour}`;
    label.append(box, swatch, this.labels[name]);
    label.title = name;
    return label;
  }
}
