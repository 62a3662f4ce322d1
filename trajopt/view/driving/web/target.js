// The target in the picture: the mouse or a finger drags it in the plane through it that faces the camera.

const GRIP = 1.8;  // how far from the centre it can be grasped, in its radii
const AXES = ["x", "y", "z"];

class TargetDrag {
    constructor(view, steering) {
        Object.assign(this, {view, steering, pane: document.getElementById("meshcat-pane"), grasped: null});
        this.ray = new view.three.Raycaster();
        // In the capturing phase: before the camera's controls, which listen on the canvas.
        this.pane.addEventListener("pointerdown", event => this.grasp(event), true);
        this.pane.addEventListener("pointermove", event => this.move(event), true);
        this.pane.addEventListener("lostpointercapture", event => this.release(event));
        this.show();
    }

    show() {
        this.view.showTarget(AXES.map(axis => this.steering.shown.get(axis)));
    }

    // The pointer's ray in the world of three.js, and whether it meets the target.
    aim(event) {
        const THREE = this.view.three, {left, top, width, height} = this.pane.getBoundingClientRect();
        const x = (event.clientX - left) / width, y = (event.clientY - top) / height;
        this.ray.setFromCamera(new THREE.Vector2(2 * x - 1, 1 - 2 * y), this.view.viewer.camera);
        this.place = this.view.target.getWorldPosition(new THREE.Vector3());
        return this.ray.ray.distanceToPoint(this.place) < GRIP * this.view.targetRadius;
    }

    grasp(event) {
        if (!event.isPrimary || event.button !== 0 || !this.aim(event)) return;
        event.stopPropagation();
        event.preventDefault();
        const THREE = this.view.three, {camera, controls} = this.view.viewer;
        const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(camera.getWorldDirection(new THREE.Vector3()), this.place);
        const offset = this.place.sub(this.ray.ray.intersectPlane(plane, new THREE.Vector3()));
        this.grasped = {pointer: event.pointerId, plane, offset};
        controls.enabled = false;
        this.pane.style.cursor = "grabbing";
        this.pane.setPointerCapture(event.pointerId);
    }

    move(event) {
        const near = this.aim(event), {pointer, plane, offset} = this.grasped || {};
        if (!this.grasped) this.pane.style.cursor = near && !event.buttons ? "grab" : "";
        if (event.pointerId !== pointer) return;
        const place = this.ray.ray.intersectPlane(plane, new this.view.three.Vector3());
        if (!place) return;
        this.view.root.worldToLocal(place.add(offset));
        this.steering.set(Object.fromEntries(AXES.map(axis => {
            const {low, high} = this.steering.inputs.get(axis).slider;
            return [axis, Math.max(low, Math.min(high, place[axis]))];
        })));
        this.show();
    }

    release(event) {
        if (!this.grasped || event.pointerId !== this.grasped.pointer) return;
        this.grasped = null;
        this.view.viewer.controls.enabled = true;
        this.pane.style.cursor = "grab";
    }
}
