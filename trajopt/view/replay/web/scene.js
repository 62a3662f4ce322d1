// What the page holds: the viewer's code, the facts and the scene, all packed.

async function unpacked(id) {
    const packed = await fetch("data:application/octet-stream;base64," + document.getElementById(id).textContent);
    return packed.body.pipeThrough(new DecompressionStream("gzip"));
}

// Meshcat's viewer is a script of its own, so that it runs as it was written: not in strict mode.
async function loadViewer() {
    const code = await new Response(await unpacked("viewer")).text();
    const url = URL.createObjectURL(new Blob([code], {type: "text/javascript"}));
    await new Promise((resolve, reject) => {
        const script = document.createElement("script");
        script.onload = resolve;
        script.onerror = () => reject(new Error("the viewer's code does not load"));
        script.src = url;
        document.head.append(script);
    });
    URL.revokeObjectURL(url);
    return new MeshCat.Viewer(document.getElementById("meshcat-pane"));
}

function restore(content, meshes) {
    for (const part of [...(content.geometries || []), content.object]) {
        if (!part) continue;
        if (part.shared !== undefined) part.data = meshes[part.shared];
        if (part.data && part.data.corners !== undefined) {
            part.data = meshes[part.shared] = restoredMesh(part.data);
        }
        // Meshcat has renamed mesh files, and warns of the old name
        if (part.type === "_meshfile") part.type = "_meshfile_geometry";
        if (part.format === "stl" && ArrayBuffer.isView(part.data)) part.data = smoothStl(part.data) || part.data;
        if (part.data && part.data.attributes) part.type = "BufferGeometry";
    }
}

// Copies of a mesh share what the graphics card holds: the first one is kept in `drawn`, by its number.
function share(viewer, command, drawn) {
    const parts = command.object.geometries || [], number = parts.length === 1 ? parts[0].shared : undefined;
    if (number === undefined) return () => {};
    if (drawn.has(number)) Object.assign(parts[0], {type: "BufferGeometry", data: {attributes: {}}, shared: undefined});
    return () => {
        const object = objectAt(viewer, command.path + "/<object>");
        if (!object.geometry) return;
        if (drawn.has(number)) object.geometry = drawn.get(number);
        else drawn.set(number, object.geometry);
    };
}

function tell(viewer, command, meshes, drawn) {
    try {
        const shared = command.object ? share(viewer, command, drawn) : () => {};
        if (command.object) restore(command.object, meshes);
        Object.getPrototypeOf(viewer).handle_command.call(viewer, command);
        shared();
    } catch (error) {  // one part that the viewer cannot read leaves the others
        console.error(command.path, error);
    }
}

// Only Meshcat's own code can decode msgpack: it hands the decoded message to `handle_command`.
function decoded(viewer, bytes) {
    let content;
    viewer.handle_command = message => { content = message; };
    viewer.handle_command_bytearray(bytes);
    delete viewer.handle_command;
    return content;
}

async function loadScene(viewer) {
    const bytes = new Uint8Array(await new Response(await unpacked("scene")).arrayBuffer());
    const scene = decoded(viewer, bytes);
    const drawn = new Map();
    for (const command of scene.commands) tell(viewer, command, scene.meshes, drawn);
}

// Messages of a server: those of Meshcat for the viewer, and ours: {type: "trajopt", path, value}.
// Returns a promise of the end of the server.
function listen(viewer, hear) {
    viewer.handle_command = command => {
        if (command.type === "trajopt") hear(command.path, command.value);
        else tell(viewer, command, [], new Map());
    };
    viewer.connect(location.origin.replace(/^http/, "ws") + "/");
    return new Promise(resolve => viewer.connection.addEventListener("close", resolve));
}

// A place in the scene tree, by its path: from the root with a leading slash, else in the world.
function objectAt(viewer, path) {
    const names = (path.startsWith("/") ? path : "/meshcat/" + path).split("/").filter(name => name);
    return viewer.scene_tree.find(names).object;
}
