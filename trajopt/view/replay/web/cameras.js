// Views that are named, and the smooth path along which they follow the robot.
// Everything here is in the coordinates of three.js: y is up.

const FIELD_OF_VIEW = 35;  // degrees, vertical: little perspective
// From the robot to the camera: forward and left of the robot as it stands first, and up.
const VIEWS = {
    overview: {from: [0.62, -1.0, 0.42], follows: false},
    follow: {from: [0.62, -1.0, 0.42], follows: true},
    side: {from: [0, -1, 0.1], follows: true},
    front: {from: [1, 0, 0.12], follows: true},
    top: {from: [-0.002, 0, 1], follows: true},
    free: {},
};
const MARGIN = 1.05;  // of the picture around what is framed
const AROUND = 0.7;  // radius that a view which follows shows around the base, in robot extents
const STILL = 0.02;  // a base that moves less than this many robot extents is none to follow
const SAMPLES = 60;  // of the path, a second of the solution: as many however slowly it plays
// The path is smoothed over this many times sqrt(extent / g), the time of a step; its height over more.
const LEVEL_SMOOTHING = 0.6, HEIGHT_SMOOTHING = 1.5, GRAVITY = 9.81;

// Gaussian average of even samples, mirrored at both ends: in the end point too if it `moves` on there.
function smoothed(values, deviation, moves) {
    const n = values.length, reach = Math.min(n - 1, Math.ceil(3 * deviation));
    if (!(deviation > 0) || reach < 1) return values.slice();
    const weights = Array.from({length: 2 * reach + 1}, (_, k) => Math.exp(-0.5 * ((k - reach) / deviation) ** 2));
    const total = weights.reduce((sum, weight) => sum + weight, 0);
    const turned = (end, value) => moves ? 2 * end - value : value;
    const at = k => {
        if (k < 0) return turned(values[0], values[-k]);
        return k < n ? values[k] : turned(values[n - 1], values[2 * n - 2 - k]);
    };
    return values.map((_, i) => weights.reduce((sum, weight, k) => sum + weight * at(i + k - reach), 0) / total);
}

class Cameras {
    constructor(viewer, clock) {
        this.viewer = viewer;
        this.clock = clock;
        this.name = "overview";
        this.following = false;
        this.listeners = [];
        this.fitted = true;
        this.studied = false;
        clock.shows.push(() => this.follow());
        window.addEventListener("resize", () => requestAnimationFrame(() => this.resized()));
    }

    get names() { return Object.keys(VIEWS).filter(name => name !== "follow" || this.moves); }

    // Reads the scene once it is there.
    study() {
        const facts = this.clock.facts, THREE = MeshCat.THREE;
        this.viewer.scene.updateMatrixWorld(true);
        const world = objectAt(this.viewer, "/meshcat").matrixWorld;
        const [low, high] = facts.box;
        this.corners = [];
        for (let k = 0; k < 8; k++) {
            const corner = [0, 1, 2].map(axis => (k >> axis & 1 ? high : low)[axis]);
            this.corners.push(new THREE.Vector3(...corner).applyMatrix4(world));
        }
        this.middle = new THREE.Box3().setFromPoints(this.corners).getCenter(new THREE.Vector3());
        this.size = facts.size;
        const paths = (facts.runs || []).filter(run => run.base).map(run => this.basePath(run.base));
        this.readPaths(paths);
        if (this.studied && this.names.includes(this.name)) this.setFollowing(this.following);
        else this.choose(facts.travels && this.moves ? "follow" : "overview");
        this.studied = true;
    }

    // Positions (m, 3) of a moving base at even times over the motion, and its heading when it starts.
    basePath(path) {
        const THREE = MeshCat.THREE, node = objectAt(this.viewer, path), parent = node.parent.matrixWorld;
        const action = this.viewer.animator.actions.find(entry => entry.getRoot() === node);
        const track = name => action && action.getClip().tracks.find(entry => entry.name === name);
        const count = Math.max(2, Math.round((this.clock.end - this.clock.start) * SAMPLES));
        const position = track(".position"), turn = track(".quaternion");
        const place = position && position.createInterpolant(new Float32Array(3));
        const points = Array.from({length: count + 1}, (_, k) => {
            const local = place ? place.evaluate(this.clock.playback * k / count) : node.position.toArray();
            return new THREE.Vector3(...local).applyMatrix4(parent);
        });
        const first = turn ? new THREE.Quaternion(...turn.values.slice(0, 4)) : node.quaternion;
        const forward = new THREE.Vector3(1, 0, 0).applyQuaternion(first).transformDirection(parent);
        return {points, forward};
    }

    // One path for the camera: the mean of the bases, smoothed; how far they are from it.
    readPaths(paths) {
        const THREE = MeshCat.THREE;
        this.forward = new THREE.Vector3(1, 0, 0);
        this.path = [this.middle.clone()];
        this.radius = AROUND * this.size;
        this.moves = false;
        if (!paths.length) return;
        const mean = paths[0].points.map((_, k) =>
            paths.reduce((sum, path) => sum.add(path.points[k]), new THREE.Vector3()).divideScalar(paths.length));
        const extent = new THREE.Box3().setFromPoints(mean).getSize(new THREE.Vector3());
        this.moves = Math.max(extent.x, extent.y, extent.z) > STILL * this.size;
        if (!this.moves) return;
        const heading = paths[0].forward.setY(0);
        if (heading.length() > 0.3) this.forward = heading.normalize();
        const apart = paths.reduce((far, path) =>
            path.points.reduce((most, point, k) => Math.max(most, point.distanceTo(mean[k])), far), 0);
        this.radius += apart;
        this.path = this.smooth(mean);
    }

    smooth(points) {
        const step = this.clock.playback * this.clock.facts.speed / (points.length - 1);
        const time = Math.sqrt(this.size / GRAVITY) / step;
        const x = smoothed(points.map(point => point.x), LEVEL_SMOOTHING * time, true);
        const y = smoothed(points.map(point => point.y), HEIGHT_SMOOTHING * time, false);
        const z = smoothed(points.map(point => point.z), LEVEL_SMOOTHING * time, true);
        return points.map((_, k) => new MeshCat.THREE.Vector3(x[k], y[k], z[k]));
    }

    // Where the camera's path is at the time that is shown: the same however that time was reached.
    focus() {
        const span = this.clock.end - this.clock.start, last = this.path.length - 1;
        const at = span > 0 ? (this.clock.time - this.clock.start) / span * last : 0;
        const before = Math.max(0, Math.min(last, Math.floor(at))), after = Math.min(last, before + 1);
        return this.path[before].clone().lerp(this.path[after], Math.min(1, at - before));
    }

    choose(name) {
        if (!this.names.includes(name)) throw new RangeError(`no camera ${name}: ${this.names.join(", ")}`);
        this.name = name;
        if (name !== "free") {
            this.following = VIEWS[name].follows && this.moves;
            this.frame(VIEWS[name]);
        }
        this.fitted = name !== "free";
        this.tell();
    }

    setFollowing(following) {
        this.following = following && this.moves;
        this.last = this.focus();
        this.tell();
    }

    tell() {
        for (const listener of this.listeners) listener();
        this.viewer.set_dirty();
    }

    resized() {
        // Another screen, or a zoom of the browser's, has other pixels.
        if (this.viewer.renderer.getPixelRatio() !== window.devicePixelRatio) this.viewer.renderer.setPixelRatio(window.devicePixelRatio);
        this.shift();
        if (this.fitted && this.path) this.frame(VIEWS[this.name]);
    }

    // Moves the picture up by half of what the bar at the bottom covers.
    shift() {
        const camera = this.viewer.camera, width = window.innerWidth, height = window.innerHeight;
        const bar = document.getElementById("bar").offsetHeight;
        this.seen = Math.max(0.5, 1 - bar / height);
        camera.setViewOffset(width, height, 0, (1 - this.seen) * height / 2, width, height);
        this.viewer.set_dirty();
    }

    frame(view) {
        const THREE = MeshCat.THREE, camera = this.viewer.camera;
        const up = new THREE.Vector3(0, 1, 0), left = new THREE.Vector3().crossVectors(up, this.forward);
        const direction = new THREE.Vector3()
            .addScaledVector(this.forward, view.from[0])
            .addScaledVector(left, view.from[1])
            .addScaledVector(up, view.from[2]).normalize();
        this.shift();
        camera.fov = FIELD_OF_VIEW;
        camera.aspect = window.innerWidth / window.innerHeight;
        this.last = this.focus();
        const target = this.following ? this.last : this.middle;
        const distance = this.following ? this.distanceOfBall() : this.distanceOfBox(direction, target);
        camera.near = distance / 50;
        camera.far = distance * 50;
        camera.position.copy(target).addScaledVector(direction, distance);
        this.attend();
        this.controls.target.copy(target);
        this.light(target);
        this.viewer.set_dirty();
    }

    // Tangents of half the angles of view, upright and across, of the part of the picture that is seen.
    slopes() {
        const upright = Math.tan(FIELD_OF_VIEW / 2 * Math.PI / 180);
        return [upright * this.seen, upright * window.innerWidth / window.innerHeight];
    }

    distanceOfBall() {
        return MARGIN * this.radius / Math.sin(Math.atan(Math.min(...this.slopes())));
    }

    distanceOfBox(direction, target) {
        const THREE = MeshCat.THREE, [upright, across] = this.slopes();
        const right = new THREE.Vector3(0, 1, 0).cross(direction).normalize();
        const up = new THREE.Vector3().crossVectors(direction, right);
        return Math.max(...this.corners.map(corner => {
            const from = corner.clone().sub(target), x = Math.abs(from.dot(right)), y = Math.abs(from.dot(up));
            return from.dot(direction) + MARGIN * Math.max(y / upright, x / across);
        }));
    }

    // The controls of the viewer in use; who drags has a view of his own, which follows if the last one did.
    attend() {
        if (this.controls === this.viewer.controls) return;
        this.controls = this.viewer.controls;
        this.controls.addEventListener("start", () => {
            this.name = "free";
            this.fitted = false;
            this.tell();
        });
    }

    follow() {
        if (!this.path || !this.following) return;
        const focus = this.focus(), moved = focus.clone().sub(this.last);
        this.last = focus;
        this.attend();
        this.viewer.camera.position.add(moved);
        this.controls.target.add(moved);
        this.light(this.controls.target);
    }

    // The lights go with the view, in steps of their shadow's cells: its edges do not flicker.
    light(target) {
        const lights = objectAt(this.viewer, "/Lights"), root = this.viewer.scene, cell = this.size / 100;
        const place = root.worldToLocal(target.clone());
        for (const axis of ["x", "y", "z"]) place[axis] = Math.round(place[axis] / cell) * cell;
        lights.position.copy(place);
        const from = root.localToWorld(place.clone());
        lights.traverse(light => {
            if (!light.target) return;
            light.target.position.copy(from);
            light.target.updateMatrixWorld();
        });
    }
}
