// What is drawn of a drive: joints, the plan's lines and footholds, forces, a target; and the camera.

const COLOURS = {base: 0x303438, feet: [0x1f77b4, 0x2ca02c, 0x9467bd, 0xc77700], force: 0xd9421f, target: 0xa3211a};
const FIELD_OF_VIEW = 35;  // degrees, vertical
const FROM = [-0.75, 0.5, 0.62];  // from the robot to the camera: three.js' axes, y is up
const DISTANCE = 3.4;  // in robot extents
const WEIGHT_ARROW = 0.8;  // length of the weight's arrow, in robot extents
const LAG = 0.12;  // share by which the camera comes nearer to the robot at each picture

const OVER = {depthTest: false, transparent: true};  // marks are seen through the robot

class View {
    constructor(viewer, facts) {
        Object.assign(this, {viewer, facts, lines: [], dots: [], arrows: [], targetRadius: 0.035 * facts.size});
        viewer.gui.domElement.remove();
        this.three = MeshCat.THREE;
        this.root = new this.three.Group();
        objectAt(viewer, "").add(this.root);
        window.addEventListener("resize", () => this.resized());
    }

    show(state) {
        state.joints.forEach((pose, number) => {
            const node = objectAt(this.viewer, this.facts.joints[number]);
            node.position.set(...pose.slice(0, 3));
            node.quaternion.set(...pose.slice(3));
        });
        this.showLines(state.lines || []);
        this.showDots(state.target ? [state.target] : state.dots || []);
        this.showForces(state.forces || []);
        if (this.facts.travels) this.follow(state.joints[0].slice(0, 3));
        this.viewer.set_dirty();
    }

    // The objects of a list, as many as there are of `wanted`; the others are hidden.
    pool(list, wanted, make) {
        while (list.length < wanted) {
            list.push(make(list.length));
            this.root.add(list[list.length - 1]);
        }
        list.forEach((object, number) => { object.visible = number < wanted; });
    }

    showLines(lines) {
        const THREE = this.three;
        this.pool(this.lines, lines.length, number => {
            const feet = COLOURS.feet, color = number ? feet[(number - 1) % feet.length] : COLOURS.base;
            const line = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({color, ...OVER}));
            line.frustumCulled = false;
            return line;
        });
        lines.forEach((points, number) => {
            const {geometry} = this.lines[number];
            geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(points.flat()), 3));
        });
    }

    showDots(dots) {
        const THREE = this.three, radius = 0.018 * this.facts.size;
        this.pool(this.dots, dots.length, () =>
            new THREE.Mesh(new THREE.SphereGeometry(radius, 16, 12), new THREE.MeshBasicMaterial({color: COLOURS.base, ...OVER})));
        dots.forEach((place, number) => this.dots[number].position.set(...place));
    }

    showForces(forces) {
        const THREE = this.three, size = this.facts.size, tip = 0.055 * size, up = new THREE.Vector3(0, 1, 0);
        this.pool(this.arrows, forces.length, () => {
            const arrow = new THREE.Group(), material = new THREE.MeshBasicMaterial({color: COLOURS.force, ...OVER, opacity: 0.8});
            const shaft = new THREE.CylinderGeometry(0.006 * size, 0.006 * size, 1, 12).translate(0, 0.5, 0);
            const head = new THREE.ConeGeometry(0.018 * size, tip, 16).translate(0, tip / 2, 0);
            arrow.add(new THREE.Mesh(shaft, material), new THREE.Mesh(head, material));
            return arrow;
        });
        forces.forEach((force, number) => {
            const arrow = this.arrows[number], along = new THREE.Vector3(...force.slice(3));
            const length = along.length() * WEIGHT_ARROW * size;
            arrow.visible = length > tip;
            if (!arrow.visible) return;
            arrow.position.set(...force.slice(0, 3));
            arrow.quaternion.setFromUnitVectors(up, along.normalize());
            arrow.children[0].scale.y = length - tip;
            arrow.children[1].position.y = length - tip;
        });
    }

    // The target where it is set; the dot is on its way there.
    showTarget(place) {
        if (!this.target) {
            const THREE = this.three, material = new THREE.MeshBasicMaterial({color: COLOURS.target, ...OVER, opacity: 0.6});
            this.target = new THREE.Mesh(new THREE.SphereGeometry(this.targetRadius, 24, 16), material);
            this.target.renderOrder = 1;
            this.root.add(this.target);
        }
        this.target.position.set(...place);
        this.viewer.set_dirty();
    }

    // Places of the solution's world in that of three.js.
    inWorld(place) {
        const node = objectAt(this.viewer, "");
        node.updateMatrixWorld(true);
        return new this.three.Vector3(...place).applyMatrix4(node.matrixWorld);
    }

    // The whole robot, from its side and behind.
    frame() {
        const THREE = this.three, {box, size} = this.facts, {camera, controls} = this.viewer;
        this.last = this.inWorld(box[0].map((low, axis) => (low + box[1][axis]) / 2));
        camera.fov = FIELD_OF_VIEW;
        camera.near = 0.05 * size;
        camera.far = 200 * size;
        camera.position.copy(this.last).addScaledVector(new THREE.Vector3(...FROM).normalize(), DISTANCE * size);
        controls.target.copy(this.last);
        this.resized();
    }

    resized() {
        const {camera} = this.viewer;
        camera.aspect = window.innerWidth / window.innerHeight;
        camera.updateProjectionMatrix();
        this.viewer.set_dirty();
    }

    // Camera and light go with the robot, smoothly; the ground in whole periods of its grid.
    follow(base) {
        const {camera, controls} = this.viewer, period = this.facts.ground;
        const place = this.inWorld(base);
        if (!this.last) this.last = place;
        const moved = place.sub(this.last).multiplyScalar(place.length() > 3 * this.facts.size ? 1 : LAG);
        moved.y = 0;
        this.last.add(moved);
        camera.position.add(moved);
        controls.target.add(moved);
        if (period) objectAt(this.viewer, "ground").position.set(...base.slice(0, 2).map(at => Math.round(at / period) * period), 0);
        const lights = objectAt(this.viewer, "/Lights"), cell = this.facts.size / 100;
        const around = this.viewer.scene.worldToLocal(this.last.clone());
        for (const axis of ["x", "y", "z"]) around[axis] = Math.round(around[axis] / cell) * cell;
        lights.position.copy(around);
        lights.traverse(light => {
            if (!light.target) return;
            light.target.position.copy(this.viewer.scene.localToWorld(around.clone()));
            light.target.updateMatrixWorld();
        });
    }
}
