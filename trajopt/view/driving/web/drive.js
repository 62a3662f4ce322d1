// The page of a drive: what the server tells is shown, and what is set is sent to it.

const STAND = "stand";
const ALIVE = 500;  // ms between two messages that say that the page is there
const OWN = 700;  // ms after a change during which the page shows its own values: those told may be older
const STEPS = 10;  // presses of a key from the middle to the end of a slider

const element = id => document.getElementById(id);

function made(kind, text = "", name = "") {
    const node = document.createElement(kind);
    node.textContent = text;
    if (name) node.className = name;
    return node;
}

function complain(text) {
    const message = element("message");
    message.hidden = !text;
    message.textContent = text;
}

// Resolves when the server has taken it; what it refuses is shown.
async function send(wanted) {
    try {
        const answer = await fetch("/command", {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(wanted)});
        complain(answer.ok ? "" : await answer.text());
    } catch (error) {
        complain("the server has stopped");
    }
}

class Steering {
    constructor(facts) {
        this.facts = facts;
        this.inputs = new Map();
        this.shown = new Map();
        this.buttons = new Map();
        this.gait = STAND;
        this.usual = facts.gaits[0];
        this.queue = null;
        this.changed = -OWN;
        this.addGaits();
        facts.sliders.forEach(slider => this.addSlider(slider));
        this.addActions();
        document.addEventListener("keydown", event => this.key(event));
    }

    addGaits() {
        if (!this.facts.gaits.length) return;
        [STAND, ...this.facts.gaits].forEach((gait, number) => {
            const button = made("button", number ? `${number} ${gait}` : gait);
            button.type = "button";
            button.addEventListener("click", () => gait === STAND ? this.stand() : this.set({gait}));
            this.buttons.set(gait, button);
            element("gaits").append(button);
        });
    }

    addSlider(slider) {
        const label = made("label"), input = made("input"), output = made("output");
        Object.assign(input, {type: "range", min: slider.low, max: slider.high, step: (slider.high - slider.low) / 200});
        input.value = slider.value;
        input.addEventListener("input", () => this.set({[slider.name]: Number(input.value)}));
        input.addEventListener("pointerup", () => input.blur());
        label.append(made("span", slider.label), input, output);
        element("sliders").append(label);
        this.inputs.set(slider.name, {input, output, slider});
        this.shown.set(slider.name, slider.value);
        this.write(slider.name, slider.value);
    }

    addActions() {
        const actions = [["space", this.facts.gaits.length ? "stand" : "back", () => this.stand()]];
        if (this.facts.gaits.length) actions.push(["P", "push", () => send({action: "push"})]);
        actions.push(["R", "reset", () => send({action: "reset"})]);
        for (const [key, text, act] of actions) {
            const button = made("button", `${text} (${key})`);
            button.type = "button";
            button.id = text;
            button.addEventListener("click", () => { act(); button.blur(); });
            element("actions").append(button);
        }
        const keys = this.facts.sliders.filter(slider => slider.keys[0]);
        element("keys").textContent = [
            ...(this.facts.target ? ["drag the red target"] : []),
            ...keys.map(slider => `${slider.keys.join(" ").toUpperCase()} ${slider.label}`),
            ...(this.facts.gaits.length ? ["numbers: gaits"] : []),
        ].join(", ");
    }

    // Values are sent together, at most every 30 ms; speeds of a robot that stands begin its usual gait.
    set(values) {
        this.changed = performance.now();
        for (const [name, value] of Object.entries(values)) {
            if (name === "gait") this.gait = value;
            else this.write(name, value);
        }
        if (this.gait !== STAND) this.usual = this.gait;
        if (this.queue) {
            Object.assign(this.queue, values);
            return;
        }
        this.queue = {...values};
        setTimeout(() => {
            const wanted = this.queue;
            this.queue = null;
            send(wanted);
        }, 30);
    }

    stand() {
        const still = this.facts.sliders.filter(slider => slider.keys[0]).map(slider => [slider.name, slider.value]);
        this.set({...Object.fromEntries(still), ...(this.facts.gaits.length ? {gait: STAND} : {})});
        this.mark();
    }

    write(name, value) {
        const {input, output, slider} = this.inputs.get(name);
        this.shown.set(name, value);
        input.value = value;
        output.textContent = `${value.toFixed(slider.high < 10 ? 2 : 0)} ${slider.unit}`;
    }

    // What the server says is set, unless that was changed here just now.
    show(state) {
        if (this.queue || performance.now() - this.changed < OWN) return;
        this.gait = state.gait;
        if (this.gait !== STAND) this.usual = this.gait;
        for (const [name, value] of Object.entries(state.values)) {
            if (!this.inputs.get(name).input.matches(":active")) this.write(name, value);
        }
        this.mark();
    }

    mark() {
        for (const [gait, button] of this.buttons) button.setAttribute("aria-pressed", gait === this.gait);
    }

    key(event) {
        if (event.ctrlKey || event.metaKey || event.altKey) return;
        const key = event.key.toLowerCase(), gait = /^[1-9]$/.test(key) && this.facts.gaits[Number(key) - 1];
        const slider = this.facts.sliders.find(each => each.keys.includes(key));
        if (gait) this.set({gait});
        else if (slider) this.step(slider, slider.keys[0] === key ? 1 : -1);
        else if (key === " ") this.stand();
        else if (key === "p" && !event.repeat && this.facts.gaits.length) send({action: "push"});
        else if (key === "r" && !event.repeat) send({action: "reset"});
        else return;
        event.preventDefault();
        this.mark();
    }

    step(slider, sign) {
        const by = sign * (slider.high - slider.low) / 2 / STEPS, value = this.shown.get(slider.name) + by;
        const values = {[slider.name]: Math.max(slider.low, Math.min(slider.high, Math.abs(value) < 1e-9 ? 0 : value))};
        if (this.gait === STAND && this.usual) values.gait = this.usual;
        this.set(values);
    }
}

function showFigures(state) {
    element("figures").replaceChildren(...state.figures.map(({label, value, warned}) => {
        const row = made("tr", "", warned ? "warned" : "");
        row.append(made("td", label), made("td", value));
        return row;
    }));
    element("fallen").hidden = !state.fallen;
    element("fallen").textContent = state.fallen && `fallen: ${state.fallen}; R resets`;
}

async function start() {
    const facts = JSON.parse(element("facts").textContent);
    element("title").textContent = facts.title;
    const viewer = await loadViewer(), view = new View(viewer, facts), steering = new Steering(facts);
    const target = facts.target ? new TargetDrag(view, steering) : null;
    Object.assign(window.trajopt, {viewer, view, steering, target});
    window.viewer = viewer;
    await new Promise(resolve => {
        const ended = listen(viewer, (path, text) => {
            const value = JSON.parse(text);
            if (path === "state") {
                window.trajopt.last = value;
                view.show(value);
                steering.show(value);
                if (target) target.show();
                showFigures(value);
            }
            if (path !== "drawn") return;
            view.frame();
            resolve();
        });
        ended.then(() => complain("the server has stopped"));
    });
    viewer.set_3d_pane_size();
    view.resized();
    send({});
    setInterval(() => send({}), ALIVE);
}

window.trajopt = {state() { return this.last; }};
window.trajopt.ready = start().catch(error => {
    complain(`The drive cannot be shown: ${error.message || error}`);
    throw error;
});
