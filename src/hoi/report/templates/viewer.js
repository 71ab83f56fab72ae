// The page's 3D view: three.js, and one file with every method's scene, compressed in the page.
(async function () {
  "use strict";
  // Inside Snakemake's report this page has no folder, so relative links lead nowhere.
  if (location.protocol === "data:" || window.self !== window.top)
    for (const link of document.querySelectorAll("a.page")) link.removeAttribute("href");
  const box = document.getElementById("view");
  if (!box) return;
  const note = document.getElementById("view-note");
  const say = (text) => { note.textContent = text; note.hidden = !text; };
  const bytes = async (id) => {
    const raw = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).arrayBuffer();
  };
  const pressed = (button) => button.getAttribute("aria-pressed") === "true";
  const buttons = (attribute) => Array.from(document.querySelectorAll(`button[${attribute}]`));
  const choose = (attribute, value) => {
    for (const button of buttons(attribute))
      button.setAttribute("aria-pressed", String(button.getAttribute(attribute) === value));
  };

  try {
    if (typeof DecompressionStream === "undefined") throw new Error("this browser is too old to unpack it");
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(await bytes("three-js"));
    document.head.appendChild(script);

    const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
    renderer.outputEncoding = THREE.sRGBEncoding;
    renderer.setClearColor(0x000000, 0);
    renderer.shadowMap.enabled = true;
    renderer.shadowMap.type = THREE.PCFSoftShadowMap;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    const canvas = renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", box.dataset.alt);
    box.appendChild(canvas);

    const world = new THREE.Scene();
    world.add(new THREE.HemisphereLight(0xffffff, 0xb7ada0, 0.72));
    const fill = new THREE.DirectionalLight(0xffffff, 0.22);
    const sun = new THREE.DirectionalLight(0xfff4e6, 0.62);
    sun.castShadow = true;
    sun.shadow.mapSize.set(1024, 1024);
    sun.shadow.radius = 5;
    sun.shadow.bias = -0.0006;
    sun.shadow.normalBias = 0.01;
    world.add(fill, sun, sun.target);

    const gltf = await new Promise((done, fail) => {
      bytes("scenes-glb").then((data) => new THREE.GLTFLoader().parse(data, "", done, fail), fail);
    });
    const extras = gltf.scene.userData;
    const colour = (code) => new THREE.Color(code).convertSRGBToLinear();
    const looks = { body: colour(box.dataset.body), object: colour(box.dataset.object) };
    const scenes = {};
    for (const root of gltf.scene.children.slice()) {
      const meshes = [];
      root.traverse((node) => { if (node.isMesh) meshes.push(node); });
      for (const mesh of meshes) {
        mesh.userData.part = mesh.name.startsWith("body") ? "body" : "object";
        const skin = mesh.userData.part === "body";
        // indices are shared among methods, so furniture gets flat shading from the shader
        if (skin) { mesh.geometry.deleteAttribute("normal"); mesh.geometry.computeVertexNormals(); }
        mesh.castShadow = mesh.receiveShadow = true;
        mesh.material = new THREE.MeshStandardMaterial(
          { roughness: skin ? 0.75 : 0.85, metalness: 0, side: THREE.DoubleSide, flatShading: !skin });
      }
      root.visible = false;
      world.add(root);
      scenes[root.name] = { root, meshes };
    }
    const names = box.dataset.order.split(" ").filter((name) => scenes[name]);
    if (!names.length) throw new Error("there is no scene in this page");

    const bounds = (name) => {
      scenes[name].root.updateWorldMatrix(true, true);
      const found = new THREE.Box3(), body = new THREE.Box3();
      for (const mesh of scenes[name].meshes) {
        const own = new THREE.Box3().setFromObject(mesh);
        found.union(own);
        if (mesh.userData.part === "body") body.union(own);
      }
      // an object metres away does not shrink the person to a dot
      const size = found.getSize(new THREE.Vector3());
      return Math.max(size.x, size.y, size.z) > 8 ? body : found;
    };

    // the floor: a grid of half metres that fades, and what falls on it
    const floor = new THREE.Group();
    const shade = new THREE.Mesh(new THREE.CircleGeometry(6, 48), new THREE.ShadowMaterial({ opacity: 0.28 }));
    shade.rotation.x = -Math.PI / 2;
    shade.receiveShadow = true;
    const lines = [], tints = [], reach = 3;
    const along = (a, b) => {
      for (let k = 0; k < 24; k++) for (const t of [k / 24, (k + 1) / 24]) {
        const x = a[0] + t * (b[0] - a[0]), z = a[1] + t * (b[1] - a[1]);
        const far = Math.min(1, Math.hypot(x, z) / reach);
        lines.push(x, -0.002, z);
        tints.push(0.35, 0.4, 0.46, Math.max(0, (1 - far * far)) * 0.55);
      }
    };
    for (let k = -reach; k <= reach; k += 0.5) { along([k, -reach], [k, reach]); along([-reach, k], [reach, k]); }
    const mesh = new THREE.BufferGeometry();
    mesh.setAttribute("position", new THREE.Float32BufferAttribute(lines, 3));
    mesh.setAttribute("color", new THREE.Float32BufferAttribute(tints, 4));
    floor.add(shade, new THREE.LineSegments(mesh, new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false })));
    world.add(floor);

    // the photo, where its camera saw it, and the camera itself
    const eye = new THREE.Vector3(), ahead = new THREE.Vector3(0, 0, -1);
    let photo = null;
    const corners = (extras.photo || []).map((p) => new THREE.Vector3(...p));
    if (extras.scene_from_camera) {
      const m = extras.scene_from_camera;
      eye.set(m[0][3], m[1][3], m[2][3]);
      ahead.set(m[0][2], m[1][2], m[2][2]).normalize();
    }
    const picture = document.getElementById("photo-texture");
    if (corners.length === 4 && picture) {
      const quad = new THREE.BufferGeometry();
      const order = [0, 3, 1, 1, 3, 2], uv = [[0, 1], [1, 1], [1, 0], [0, 0]];
      quad.setAttribute("position", new THREE.Float32BufferAttribute(order.flatMap((k) => corners[k].toArray()), 3));
      quad.setAttribute("uv", new THREE.Float32BufferAttribute(order.flatMap((k) => uv[k]), 2));
      const texture = new THREE.Texture(picture);
      texture.encoding = THREE.sRGBEncoding;
      texture.minFilter = THREE.LinearFilter;
      texture.generateMipmaps = false;
      await (picture.decode ? picture.decode().catch(() => undefined) : undefined);
      texture.needsUpdate = true;
      photo = new THREE.Mesh(quad, new THREE.MeshBasicMaterial({ map: texture, side: THREE.DoubleSide, toneMapped: false }));
      photo.visible = false;
      const near = corners.map((p) => eye.clone().lerp(p, 0.35 / p.distanceTo(eye)));
      const wires = [];
      for (let k = 0; k < 4; k++) wires.push(eye, near[k], near[k], near[(k + 1) % 4]);
      const frustum = new THREE.LineSegments(
        new THREE.BufferGeometry().setFromPoints(wires), new THREE.LineBasicMaterial({ color: 0x59636e }));
      frustum.name = "camera";
      world.add(photo, frustum);
    }

    const camera = new THREE.PerspectiveCamera(30, 1, 0.02, 300);
    const controls = new THREE.TrackballControls(camera, canvas);
    controls.rotateSpeed = 2.2; controls.panSpeed = 0.5; controls.staticMoving = true;
    controls.minDistance = 0.3; controls.maxDistance = 60; controls.noZoom = true;
    // The wheel scrolls the page until the view has been touched.
    canvas.addEventListener("pointerdown", () => { controls.noZoom = false; });
    canvas.addEventListener("pointerleave", (event) => { if (!event.buttons) controls.noZoom = true; });

    let current = null, stale = true;
    const up = new THREE.Vector3(0, 1, 0), safe = new THREE.Vector3();
    const draw = () => {
      fill.position.copy(camera.position);
      sun.position.copy(sun.target.position).add(new THREE.Vector3(1.6, 4.2, 1.9));
      renderer.render(world, camera);
    };
    controls.addEventListener("change", () => { stale = true; });
    const tick = () => {
      requestAnimationFrame(tick);
      safe.copy(camera.position);
      controls.update();
      if (!stale) return;
      stale = false;
      // Trackball controls may roll; keep gravity down and stay off the poles.
      const way = camera.position.clone().sub(controls.target).normalize();
      if (Math.abs(way.y) > 0.9988) camera.position.copy(safe);
      camera.up.copy(up);
      camera.lookAt(controls.target);
      draw();
    };

    const look = (view) => {
      const ball = bounds(current).getBoundingSphere(new THREE.Sphere());
      controls.target.copy(ball.center);
      const backdrop = view === "photo" && photo;
      if (view === "photo") {
        camera.position.copy(eye);
        const depth = Math.max(ball.center.clone().sub(eye).dot(ahead), 0.5);
        camera.fov = 2 * THREE.MathUtils.radToDeg(Math.atan(1.35 * ball.radius / depth / Math.min(1, camera.aspect)));
        camera.fov = Math.min(camera.fov, 75);
      } else {
        const way = { front: [0.5, 0.28, 1], side: [1, 0.05, 0], top: [0, 1, 0.06] }[view];
        camera.fov = 30;
        const narrow = Math.min(1, camera.aspect);
        const far = 1.03 * ball.radius / Math.sin(THREE.MathUtils.degToRad(camera.fov / 2)) / narrow;
        camera.position.copy(ball.center).addScaledVector(new THREE.Vector3(...way).normalize(), far);
      }
      if (photo) {
        photo.visible = Boolean(backdrop);
        floor.visible = !backdrop && partShown("ground");
        for (const button of buttons("data-part"))
          if (button.dataset.part === "photo") button.setAttribute("aria-pressed", String(Boolean(backdrop)));
      }
      camera.updateProjectionMatrix();
      camera.up.copy(up);
      camera.lookAt(controls.target);
      choose("data-view", view);
      stale = true;
    };
    const partShown = (part) => {
      const button = buttons("data-part").find((b) => b.dataset.part === part);
      return !button || pressed(button);
    };
    const dress = () => {
      const heat = partShown("contact"), ghost = partShown("truth") && scenes.truth && current !== "truth"
        && buttons("data-part").some((b) => b.dataset.part === "truth");
      for (const name of Object.keys(scenes)) {
        const shown = name === current, faint = name === "truth" && ghost;
        scenes[name].root.visible = shown || faint;
        for (const mesh of scenes[name].meshes) {
          const part = mesh.userData.part, material = mesh.material;
          mesh.visible = partShown(part);
          const painted = heat && part === "body" && Boolean(mesh.geometry.attributes.color) && !faint;
          material.vertexColors = painted;
          if (faint) material.color.set(0x3aa76d).convertSRGBToLinear();
          else if (painted) material.color.set(0xffffff);
          else material.color.copy(looks[part]);
          material.transparent = faint;
          material.opacity = faint ? 0.45 : 1;
          material.depthWrite = !faint;
          mesh.castShadow = !faint;
          material.needsUpdate = true;
        }
      }
      if (photo) photo.visible = partShown("photo");
      floor.visible = partShown("ground") && !(photo && photo.visible);
      const frustum = world.getObjectByName("camera");
      if (frustum) frustum.visible = !(photo && photo.visible);
      stale = true;
    };
    const show = (name) => {
      const first = current === null;
      current = name;
      choose("data-method", name);
      const ball = bounds(name).getBoundingSphere(new THREE.Sphere());
      sun.target.position.copy(ball.center);
      const half = Math.min(ball.radius * 1.5, 6), shadow = sun.shadow.camera;
      shadow.left = shadow.bottom = -half; shadow.right = shadow.top = half;
      shadow.near = 0.1; shadow.far = 20; shadow.updateProjectionMatrix();
      dress();
      if (first) look("front");
    };
    const fit = () => {
      const width = box.clientWidth, height = box.clientHeight;
      if (!width || !height) return;
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      renderer.setSize(width, height);
      controls.handleResize();
      stale = true;
    };

    document.addEventListener("click", async (event) => {
      const button = event.target.closest("button");
      if (!button || current === null) return;
      if (button.id === "save") {
        const link = document.createElement("a");
        link.href = URL.createObjectURL(new Blob([await bytes("scenes-glb")], { type: "model/gltf-binary" }));
        link.download = `${box.dataset.file}.glb`;
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 1000);
      } else if (button.dataset.method !== undefined) show(button.dataset.method);
      else if (button.dataset.view) { look(button.dataset.view); dress(); }
      else if (button.dataset.part) {
        button.setAttribute("aria-pressed", String(!pressed(button)));
        dress();
      }
    });
    canvas.addEventListener("keydown", (event) => {
      const turn = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, -0.12], ArrowDown: [0, 0.12] }[event.key];
      const zoom = { "+": 0.9, "=": 0.9, "-": 1.1 }[event.key];
      if (!turn && !zoom) return;
      event.preventDefault();
      const ball = new THREE.Spherical().setFromVector3(camera.position.clone().sub(controls.target));
      if (turn) {
        ball.theta += turn[0];
        ball.phi = Math.min(Math.max(ball.phi + turn[1], 0.05), Math.PI - 0.05);
      }
      ball.radius *= zoom || 1;
      camera.position.setFromSpherical(ball).add(controls.target);
      stale = true;
    });
    fit();
    new ResizeObserver(fit).observe(box);
    say("");
    show(scenes[box.dataset.first] ? box.dataset.first : names[0]);
    tick();
    document.documentElement.dataset.viewer = "ready";
  } catch (error) {
    document.documentElement.dataset.viewer = "failed";
    box.classList.add("none");
    say(`The 3D view is not available here (${error.message}). The pictures on this page show the same scene.`);
  }
})();
