// Puts the page together, and offers it to scripts as `window.trajopt`.

class Layers {
    constructor(viewer, clock) {
        Object.assign(this, {viewer, clock, all: [], listeners: []});
    }

    read() {
        const chosen = new Map(this.all.map(layer => [layer.name, layer.visible]));
        this.all = (this.clock.facts.layers || []).map(layer => ({...layer, visible: chosen.get(layer.name) ?? layer.visible}));
        for (const layer of this.all) this.apply(layer);
    }

    apply(layer) {
        for (const path of layer.paths) objectAt(this.viewer, path).visible = layer.visible;
        this.viewer.set_dirty();
    }

    set(name, visible) {
        const layer = this.all.find(entry => entry.name === name);
        if (!layer) throw new RangeError(`no layer ${name}: ${this.all.map(entry => entry.name).join(", ")}`);
        layer.visible = Boolean(visible);
        this.apply(layer);
        for (const listener of this.listeners) listener();
    }
}

// "#t=0.35&camera=side&panel=off": opens paused at that time of the solution. "bare" hides all text.
function obey(hash, clock, cameras, autoplay) {
    const wanted = new URLSearchParams(hash.replace(/^#/, ""));
    document.body.classList.toggle("no-panel", wanted.get("panel") === "off");
    document.body.classList.toggle("bare", wanted.has("bare"));
    cameras.shift();
    const camera = wanted.get("camera"), time = Number(wanted.get("t"));
    if (cameras.names.includes(camera)) cameras.choose(camera);
    else cameras.resized();
    if (wanted.get("t") && Number.isFinite(time)) {
        clock.pause();
        clock.seek(time);
    } else if (autoplay) {
        clock.seek(clock.start);
        clock.play();
    }
}

function connectKeys(clock, cameras, panel) {
    const keys = {
        " ": () => clock.toggle(),
        ArrowLeft: () => clock.move(-1),
        ArrowRight: () => clock.move(1),
        PageUp: () => clock.move(-10),
        PageDown: () => clock.move(10),
        Home: () => clock.seek(clock.start),
        End: () => { clock.pause(); clock.seek(clock.end); },
        "[": () => clock.changeRate(-1),
        "]": () => clock.changeRate(1),
        l: () => { clock.loop = !clock.loop; clock.changed(); },
        f: () => cameras.setFollowing(!cameras.following),
        h: () => panel.toggleSide(),
    };
    document.addEventListener("keydown", event => {
        const field = event.target.closest("input, select, textarea, summary, button");
        if (event.ctrlKey || event.metaKey || event.altKey) return;
        if (field && (event.key === " " || /^(Arrow|Page|Home|End)/.test(event.key) && field.tagName !== "BUTTON")) return;
        const camera = /^[1-9]$/.test(event.key) && cameras.names[Number(event.key) - 1];
        const action = camera ? () => cameras.choose(camera) : keys[event.key];
        if (!action) return;
        event.preventDefault();
        action();
    });
}

function complain(text) {
    const message = element("message");
    message.hidden = false;
    message.textContent = text;
}

async function start() {
    const facts = JSON.parse(element("facts").textContent);
    const viewer = await loadViewer();
    const clock = new Clock(viewer, facts), cameras = new Cameras(viewer, clock), layers = new Layers(viewer, clock);
    const panel = new Panel(viewer, clock, cameras, layers);
    Object.assign(window.trajopt, {viewer, clock, view: cameras, switches: layers});
    window.viewer = viewer;  // Meshcat's own pages have it, and scripts that add controls use it
    connectKeys(clock, cameras, panel);
    const drawn = () => {
        cameras.study();
        layers.read();
        panel.write();
        clock.refresh();
    };
    if (facts.live) await hearScene(viewer, clock, drawn);
    else await loadScene(viewer).then(drawn);
    viewer.set_3d_pane_size();
    obey(location.hash, clock, cameras, false);
    viewer.render();
    window.addEventListener("hashchange", () => obey(location.hash, clock, cameras, true));
    if (!/[#&]t=/.test(location.hash)) clock.play();
}

// Resolves when the scene is there; whatever is told later is shown as it comes.
function hearScene(viewer, clock, drawn) {
    return new Promise(resolve => {
        const ended = listen(viewer, (path, value) => {
            if (path === "facts") clock.adopt(value);
            if (path !== "drawn") return;
            drawn();
            resolve();
        });
        ended.then(() => complain("the server has stopped"));
    });
}

// For scripts: times are seconds of the solution; `duration` too, so it plays for duration / speed seconds.
window.trajopt = {
    get start() { return this.clock.start; },
    get duration() { return this.clock.end - this.clock.start; },
    get speed() { return this.clock.rate; },
    get cameras() { return this.view.names; },
    get layers() { return this.clock.facts.layers.map(layer => layer.name); },
    seek(time) { this.clock.seek(time); },
    play() { this.clock.play(); },
    pause() { this.clock.pause(); },
    camera(name) { this.view.choose(name); },
    layer(name, visible) { this.switches.set(name, visible); },
    state() {
        const clock = this.clock, phase = (clock.facts.phases || [])[clock.phaseAt(clock.time)];
        return {time: clock.time, playing: clock.playing, phase: phase ? phase.name : "", camera: this.view.name, drawn: clock.drawn};
    },
    render() { this.viewer.render(); },
};
window.trajopt.ready = start().catch(error => {
    complain(`The replay cannot be shown: ${error.message || error}`);
    throw error;
});
