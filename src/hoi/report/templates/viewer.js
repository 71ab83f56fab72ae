// Shows the page's scenes with three.js. Data and library sit compressed in the page itself.
(async function () {
  "use strict";
  const box = document.getElementById("view");
  if (!box) return;
  const note = document.getElementById("view-note");
  const say = (text) => { note.textContent = text; note.hidden = !text; };
  const bytes = async (id) => {
    const raw = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).arrayBuffer();
  };
  const load = (data) => new Promise((done, fail) => new THREE.GLTFLoader().parse(data, "", done, fail));

  try {
    if (typeof DecompressionStream === "undefined") throw new Error("this browser is too old to unpack it");
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(await bytes("three-js"));
    document.head.appendChild(script);

    const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    renderer.outputEncoding = THREE.sRGBEncoding;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    const canvas = renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", box.dataset.alt);
    box.appendChild(canvas);

    const world = new THREE.Scene();
    world.background = new THREE.Color(0xfbfbfa).convertSRGBToLinear();
    world.add(new THREE.HemisphereLight(0xffffff, 0xb9b4aa, 0.75));
    const light = new THREE.DirectionalLight(0xffffff, 0.55);
    world.add(light);

    const scenes = {};
    for (const holder of document.querySelectorAll("script[data-scene]")) {
      const data = await bytes(holder.id);
      const gltf = await load(data);
      gltf.scene.traverse((node) => {
        if (!node.isMesh) return;
        const flat = node.name !== "body";
        if (!flat && !node.geometry.attributes.normal) node.geometry.computeVertexNormals();
        node.material = new THREE.MeshStandardMaterial(
          { vertexColors: true, roughness: 0.9, metalness: 0, side: THREE.DoubleSide, flatShading: flat });
      });
      gltf.scene.visible = false;
      world.add(gltf.scene);
      scenes[holder.dataset.scene] = { root: gltf.scene, photo: gltf.cameras[0], data };
    }

    const camera = new THREE.PerspectiveCamera(35, 1, 0.02, 200);
    const controls = new THREE.TrackballControls(camera, canvas);
    controls.rotateSpeed = 2.2; controls.panSpeed = 0.5; controls.staticMoving = true;
    controls.minDistance = 0.3; controls.maxDistance = 60; controls.noZoom = true;
    // The wheel scrolls the page until the view has been touched.
    canvas.addEventListener("pointerdown", () => { controls.noZoom = false; });
    canvas.addEventListener("pointerleave", (event) => { if (!event.buttons) controls.noZoom = true; });

    let current = null;
    const up = new THREE.Vector3(0, 1, 0);
    const safe = new THREE.Vector3();
    const draw = () => { light.position.copy(camera.position).add(new THREE.Vector3(0.6, 1.5, 0)); renderer.render(world, camera); };
    const tick = () => {
      requestAnimationFrame(tick);
      if (!current) return;
      safe.copy(camera.position);
      controls.update();
      // Trackball controls may roll; keep gravity down and stay off the poles.
      const eye = camera.position.clone().sub(controls.target).normalize();
      if (Math.abs(eye.y) > 0.9988) camera.position.copy(safe);
      camera.up.copy(up);
      camera.lookAt(controls.target);
      draw();
    };

    const look = (view) => {
      const bounds = new THREE.Box3();
      for (const name of ["body", "object"]) {
        const node = current.root.getObjectByName(name);
        if (node) bounds.expandByObject(node);
      }
      const ball = bounds.getBoundingSphere(new THREE.Sphere());
      controls.target.copy(ball.center);
      if (view === "photo") {
        const eye = new THREE.Vector3(), ahead = new THREE.Vector3();
        current.photo.getWorldPosition(eye);
        current.photo.getWorldDirection(ahead);
        const depth = Math.max(ball.center.clone().sub(eye).dot(ahead), 0.5);
        camera.position.copy(eye);
        controls.target.copy(eye).addScaledVector(ahead, depth);
        camera.fov = Math.min(current.photo.fov, 2 * THREE.MathUtils.radToDeg(Math.atan(1.15 * ball.radius / depth)));
        controls.target.copy(ball.center);
      } else {
        const way = { front: [0.45, 0.3, 1], side: [1, 0.08, 0], top: [0, 1, 0.06] }[view];
        camera.fov = 35;
        const narrow = Math.min(1, camera.aspect);
        const far = 1.05 * ball.radius / Math.sin(THREE.MathUtils.degToRad(camera.fov / 2)) / narrow;
        camera.position.copy(ball.center).addScaledVector(new THREE.Vector3(...way).normalize(), far);
      }
      camera.updateProjectionMatrix();
      camera.up.copy(up);
      camera.lookAt(controls.target);
      press("data-view", view);
    };
    const press = (attribute, value) => {
      for (const button of document.querySelectorAll(`button[${attribute}]`))
        button.setAttribute("aria-pressed", String(button.getAttribute(attribute) === value));
    };
    const show = (name) => {
      const first = current === null;
      if (current) current.root.visible = false;
      current = scenes[name];
      current.root.visible = true;
      parts();
      press("data-method", name);
      if (first) look("front");
    };
    const parts = () => {
      for (const button of document.querySelectorAll("button[data-part]")) {
        const node = current.root.getObjectByName(button.dataset.part);
        if (node) node.visible = button.getAttribute("aria-pressed") === "true";
      }
    };
    const fit = () => {
      const width = box.clientWidth, height = box.clientHeight;
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      renderer.setSize(width, height);
      controls.handleResize();
    };

    document.addEventListener("click", (event) => {
      const button = event.target.closest("button");
      if (!button || !current) return;
      if (button.dataset.method !== undefined) show(button.dataset.method);
      else if (button.dataset.view) look(button.dataset.view);
      else if (button.dataset.part) {
        button.setAttribute("aria-pressed", String(button.getAttribute("aria-pressed") !== "true"));
        parts();
      } else if (button.dataset.save !== undefined) {
        const name = Object.keys(scenes).find((key) => scenes[key] === current);
        const link = document.createElement("a");
        link.href = URL.createObjectURL(new Blob([current.data], { type: "model/gltf-binary" }));
        link.download = `${box.dataset.file}_${name}.glb`;
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 1000);
      }
    });
    canvas.addEventListener("keydown", (event) => {
      const turn = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, -0.12], ArrowDown: [0, 0.12] }[event.key];
      if (!turn) return;
      event.preventDefault();
      const ball = new THREE.Spherical().setFromVector3(camera.position.clone().sub(controls.target));
      ball.theta += turn[0];
      ball.phi = Math.min(Math.max(ball.phi + turn[1], 0.05), Math.PI - 0.05);
      camera.position.setFromSpherical(ball).add(controls.target);
    });
    fit();
    new ResizeObserver(fit).observe(box);
    const names = Object.keys(scenes);
    if (names.length) { say(""); show(scenes[box.dataset.first] ? box.dataset.first : names[0]); tick(); document.documentElement.dataset.viewer = "ready"; }
  } catch (error) {
    document.documentElement.dataset.viewer = "failed";
    say(`The 3D view is not available here (${error.message}). The pictures above show the same scene.`);
  }
})();
