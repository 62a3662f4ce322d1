// One time, in seconds of the solution, which everything shows. Meshcat's animation panel reads and sets it.

const HOLD = 0.8;  // s that the last picture stays before the motion starts again
const SPEEDS = [0.1, 0.25, 0.5, 1, 2];

class Clock {
    constructor(viewer, facts) {
        this.viewer = viewer;
        this.animator = viewer.animator;
        this.playing = false;
        this.loop = true;
        this.drawn = 0;
        this.shows = [];
        this.changes = [];
        this.held = 0;
        this.adopt(facts);
        this.takeOver();
        // No picture is drawn of a page behind another: the motion goes on where it was left.
        document.addEventListener("visibilitychange", () => { this.last = null; });
    }

    adopt(facts) {
        this.facts = facts;
        this.rate = this.rate || facts.speed;
        this.start = facts.start;
        this.time = this.time ?? facts.start;
    }

    // s of playback: of the animation that is loaded, should a script have loaded one of its own
    get playback() {
        const loaded = this.animator.duration, own = this.facts.duration;
        return loaded > 0 && Math.abs(loaded - own) > 1e-3 * own ? loaded : own;
    }

    get end() { return this.start + this.playback * this.facts.speed; }

    get step() { return this.facts.picture || this.facts.speed / 60; }

    phaseAt(time) {
        const phases = this.facts.phases || [];
        let found = 0;
        phases.forEach((phase, number) => { if (phase.start <= time + 1e-9) found = number; });
        return phases.length ? found : -1;
    }

    show(time) {
        this.time = Math.max(this.start, Math.min(this.end, time));
        const at = (this.time - this.start) / this.facts.speed;
        for (const action of this.animator.actions) action.time = Math.min(at, action.getClip().duration);
        this.animator.mixer.update(0);
        this.animator.time = this.time;
        if (this.animator.time_scrubber) this.animator.time_scrubber.updateDisplay();
        for (const listener of this.shows) listener(this.time);
        this.viewer.set_dirty();
    }

    changed() {
        for (const listener of this.changes) listener();
        if (this.speedControl) this.speedControl.updateDisplay();
    }

    play() {
        if (this.time >= this.end) this.show(this.start);
        this.last = null;  // time passes from the first picture on
        this.playing = true;
        this.changed();
    }

    pause() {
        this.playing = false;
        this.changed();
        const animator = this.animator;
        if (animator.recording) {
            animator.stop_capture();
            animator.save_capture();
        }
    }

    toggle() { this.playing ? this.pause() : this.play(); }

    seek(time) {
        this.held = 0;
        this.show(time);
    }

    // Stops, and shows the picture `count` further: of the pictures of the animation, not of the screen.
    move(count) {
        this.pause();
        const picture = Math.round((this.time - this.start) / this.step) + count;
        this.seek(this.start + picture * this.step);
    }

    setRate(rate) {
        if (!(rate > 0)) return;
        this.rate = rate;
        this.changed();
    }

    // To the next speed of the list that is slower (-1) or faster (1).
    changeRate(sign) {
        const further = SPEEDS.filter(speed => sign * (speed - this.rate) > 1e-9);
        if (further.length) this.setRate(sign > 0 ? further[0] : further[further.length - 1]);
    }

    tick() {
        if (!this.playing) return;
        const now = performance.now(), passed = this.last === null ? 0 : (now - this.last) / 1000;
        this.last = now;
        if (this.time < this.end) {
            this.show(this.time + passed * this.rate);
            return;
        }
        this.held += passed;
        this.viewer.set_dirty();
        if (this.animator.recording || !this.loop) {
            this.pause();
        } else if (this.held >= HOLD) {
            this.seek(this.start);
        }
    }

    takeOver() {
        const animator = this.animator, clock = this, load = animator.load;
        animator.load = function (animations, options) {
            load.call(this, animations, {...options, play: false});
            clock.loaded();
        };
        animator.update = () => this.tick();
        animator.play = () => this.play();
        animator.pause = () => this.pause();
        animator.seek = time => this.seek(time);
        animator.reset = function () {
            clock.seek(clock.start);
            this.setup_capturer(this.capturer.format);
        };
        const render = this.viewer.render;
        this.viewer.render = function () {
            render.call(this);
            clock.drawn += 1;
        };
    }

    // After an animation is loaded: Meshcat's panel shows the solution's time and our speed.
    loaded() {
        const animator = this.animator, folder = animator.folder.__folders.default;
        for (const action of animator.actions) action.play();  // active; its time is set by `show`
        folder.remove(folder.__controllers.find(entry => entry.property === "timeScale"));
        this.speedControl = folder.add(this, "rate", 0.05, 2, 0.05).name("speed").onChange(() => this.changed());
        this.refresh();
    }

    refresh() {
        const scrubber = this.animator.time_scrubber;
        if (scrubber) scrubber.min(this.start).max(this.end);
        this.show(this.time);
    }
}
