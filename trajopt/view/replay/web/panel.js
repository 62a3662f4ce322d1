// What surrounds the picture: caption, phase bar, buttons, layers. Each is made from the facts.

// Pale enough for dark text, and told apart by the colour-blind; a phase is also told by its name.
const TINTS = ["#bcd7ee", "#ffdca8", "#cde8c6", "#ead0e4", "#f7eca6", "#f6c9bf", "#d3d9e0"];

const element = id => document.getElementById(id);

function made(kind, text = "", name = "") {
    const node = document.createElement(kind);
    node.textContent = text;
    if (name) node.className = name;
    return node;
}

function swatch(colour) {
    const node = made("span", "", "swatch");
    node.style.background = colour;
    return node;
}

class Panel {
    constructor(viewer, clock, cameras, layers) {
        Object.assign(this, {viewer, clock, cameras, layers});
        clock.shows.push(time => this.show(time));
        clock.changes.push(() => this.showControls());
        cameras.listeners.push(() => this.showCameras());
        layers.listeners.push(() => this.showLayers());
        this.connectButtons();
        this.connectPhases();
        this.place(viewer.gui);
        const small = window.matchMedia("(max-width: 760px), (max-height: 460px)");  // as in page.css
        const arrange = () => {
            element("about").open = !small.matches;
            this.setSide(!small.matches);
        };
        small.addEventListener("change", arrange);
        arrange();
    }

    // Meshcat's own panel, below ours: open at its animation.
    place(gui) {
        element("gui").append(gui.domElement);
        gui.open();
        for (const name of ["Scene", "Save / Load / Capture"]) gui.__folders[name].close();
    }

    // Writes everything that depends on the facts.
    write() {
        const facts = this.clock.facts;
        document.title = facts.title;
        element("title").textContent = facts.title;
        element("lines").replaceChildren(...(facts.lines || []).map(line => {
            const node = made("div", "", line.kind);
            if (line.colour) node.append(swatch(line.colour));
            node.append(line.text);
            if (line.layer) node.dataset.layer = line.layer;
            return node;
        }));
        this.writePhases(facts);
        this.writeLayers();
        this.writeCameras();
        this.showControls();
    }

    writePhases(facts) {
        const phases = facts.phases || [], names = [...new Set(phases.map(phase => phase.name))];
        const span = this.clock.end - this.clock.start;
        this.segments = phases.map((phase, number) => {
            const node = made("span", phase.name), end = number + 1 < phases.length ? phases[number + 1].start : this.clock.end;
            node.style.width = 100 * (end - phase.start) / span + "%";
            node.style.background = TINTS[names.indexOf(phase.name) % TINTS.length];
            node.title = `${phase.name}: ${phase.start.toFixed(2)} to ${phase.end.toFixed(2)} s`;
            return node;
        });
        element("segments").replaceChildren(...this.segments);
        const bar = element("phases");
        bar.setAttribute("aria-valuemin", this.clock.start.toFixed(3));
        bar.setAttribute("aria-valuemax", this.clock.end.toFixed(3));
    }

    writeLayers() {
        const colours = new Map((this.clock.facts.runs || []).map(run => [run.root, run.colour]));
        let grouped = false;
        this.boxes = this.layers.all.map(layer => {
            const label = made("label"), box = document.createElement("input");
            box.type = "checkbox";
            box.addEventListener("change", () => this.layers.set(layer.name, box.checked));
            label.append(box, swatch(layer.colour), layer.label);
            const isRun = layer.name && colours.has(layer.name);
            if (isRun && !grouped) label.className = "group";
            grouped = grouped || isRun;
            return {layer, box, label};
        });
        element("layers").replaceChildren(...this.boxes.map(entry => entry.label));
        this.showLayers();
    }

    writeCameras() {
        this.views = this.cameras.names.map((name, number) => {
            const button = made("button", name);
            button.type = "button";
            button.dataset.view = name;
            button.title = `${name} view (${number + 1})`;
            button.addEventListener("click", () => this.cameras.choose(name));
            return {name, button};
        });
        element("cameras").replaceChildren(...this.views.map(view => view.button));
        element("follows").hidden = !this.cameras.moves;
        this.showCameras();
    }

    show(time) {
        const clock = this.clock, number = clock.phaseAt(time), phase = (clock.facts.phases || [])[number];
        element("time").textContent = `t = ${time.toFixed(2)} s`;
        element("phase").textContent = phase ? phase.name : "";
        element("progress").textContent = `${time.toFixed(2)} of ${clock.end.toFixed(2)} s`;
        element("cursor").style.left = 100 * (time - clock.start) / (clock.end - clock.start) + "%";
        (this.segments || []).forEach((node, k) => node.classList.toggle("now", k === number));
        const bar = element("phases");
        bar.setAttribute("aria-valuenow", time.toFixed(3));
        bar.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds${phase ? ", " + phase.name : ""}`);
    }

    showControls() {
        const {playing, loop, rate} = this.clock, choice = element("rate");
        element("play").classList.toggle("playing", playing);
        element("play").setAttribute("aria-label", playing ? "pause" : "play");
        element("loop").setAttribute("aria-pressed", loop);
        const speeds = [...new Set([...SPEEDS, this.clock.facts.speed, rate])].sort((a, b) => a - b);
        choice.replaceChildren(...speeds.map(speed => {
            const option = made("option", `${Number(speed.toPrecision(3))}×`);
            option.value = speed;
            option.selected = speed === rate;
            return option;
        }));
    }

    showCameras() {
        for (const {name, button} of this.views || []) {
            button.setAttribute("aria-pressed", name === this.cameras.name);
        }
        element("follows").setAttribute("aria-pressed", this.cameras.following);
    }

    showLayers() {
        for (const {layer, box} of this.boxes || []) {
            box.checked = layer.visible;
            for (const line of document.querySelectorAll(`#lines [data-layer="${layer.name}"]`)) line.hidden = !layer.visible;
        }
    }

    setSide(shown) {
        document.body.classList.toggle("no-side", !shown);
        element("panels").setAttribute("aria-pressed", shown);
    }

    toggleSide() { this.setSide(document.body.classList.contains("no-side")); }

    connectButtons() {
        const {clock, cameras} = this;
        const actions = {
            first: () => clock.seek(clock.start),
            play: () => clock.toggle(),
            loop: () => { clock.loop = !clock.loop; clock.changed(); },
            follows: () => cameras.setFollowing(!cameras.following),
            panels: () => this.toggleSide(),
        };
        for (const [id, action] of Object.entries(actions)) element(id).addEventListener("click", action);
        element("rate").addEventListener("change", event => clock.setRate(Number(event.target.value)));
        // After a click the space bar plays again, instead of pressing the same button.
        element("bar").addEventListener("click", event => {
            const button = event.target.closest("button");
            if (button && event.detail > 0) button.blur();
        });
    }

    // Click or drag: the motion waits while the cursor is held.
    connectPhases() {
        const bar = element("phases"), clock = this.clock;
        const seek = event => {
            const place = bar.getBoundingClientRect(), part = (event.clientX - place.left) / place.width;
            clock.seek(clock.start + Math.max(0, Math.min(1, part)) * (clock.end - clock.start));
        };
        let resumes = null;
        bar.addEventListener("pointerdown", event => {
            if (event.button || resumes !== null) return;  // a second finger changes nothing
            bar.setPointerCapture(event.pointerId);
            resumes = clock.playing;
            if (resumes) clock.pause();
            seek(event);
        });
        bar.addEventListener("pointermove", event => { if (resumes !== null) seek(event); });
        const release = () => {
            if (resumes) clock.play();
            resumes = null;
        };
        bar.addEventListener("pointerup", release);
        bar.addEventListener("pointercancel", release);
    }
}
