"use strict";

/* Draws legs in three dimensions by three.js. One WebGL canvas serves the boxes of all legs. */
const StageSolid = (() => {
  const FIELD_DEG = 24;
  const OUTLINE_M = 0.0045;
  const OUTLINE_COLOUR = 0x15181c;
  const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i;
  const SKIN_LAYER = 1; // not in the view of the linkage

  function geometry(part, grown = 0) {
    const [a, b, c] = part.size;
    if (part.shape === "box") return new THREE.BoxGeometry(a, b, c);
    if (part.shape === "ellipsoid") {
      return new THREE.SphereGeometry(1, 28, 18).scale(a + grown, b + grown, c + grown);
    }
    const shape =
      part.shape === "capsule"
        ? new THREE.CapsuleGeometry(a + grown, b, 6, 24)
        : new THREE.CylinderGeometry(a + grown, a + grown, b, 24);
    return shape.rotateX(Math.PI / 2); // Drake's axis is z, that of three.js is y
  }

  function colourOf([red, green, blue]) {
    return new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace);
  }

  function mesh(part, material, order = 0, grown = 0) {
    const object = new THREE.Mesh(geometry(part, grown), material);
    object.name = part.name;
    object.position.fromArray(part.position);
    object.quaternion.fromArray(part.quaternion);
    object.renderOrder = order;
    return object;
  }

  /** Skin. Its depth is drawn before its colour, so one layer of a limb does not shine through another. */
  function skin(part) {
    const options = { transparent: true, opacity: part.colour[3], color: colourOf(part.colour) };
    const meshes = [
      mesh(part, new THREE.MeshBasicMaterial({ transparent: true, colorWrite: false }), 1),
      mesh(part, new THREE.MeshLambertMaterial(options), 2),
    ];
    for (const object of meshes) object.layers.set(SKIN_LAYER);
    return meshes;
  }

  /** The outline of the reference. It ignores depth, so equal surfaces do not flicker. */
  function ghost(part) {
    const common = { transparent: true, depthTest: false, depthWrite: false };
    const stencil = { stencilWrite: true, stencilRef: 1 };
    const inside = { colorWrite: false, stencilZPass: THREE.ReplaceStencilOp };
    const outside = { color: OUTLINE_COLOUR, stencilFunc: THREE.NotEqualStencilFunc };
    const meshes = [
      mesh(part, new THREE.MeshBasicMaterial({ ...common, ...stencil, ...inside }), 3),
      mesh(part, new THREE.MeshBasicMaterial({ ...common, ...stencil, ...outside }), 4, OUTLINE_M),
    ];
    for (const object of meshes) object.layers.set(SKIN_LAYER);
    return meshes;
  }

  function objectsOf(part) {
    if (part.role === "skin") return skin(part);
    if (part.role === "ghost") return ghost(part);
    return [mesh(part, new THREE.MeshLambertMaterial({ color: colourOf(part.colour) }))];
  }

  function path({ points, colour }) {
    const curve = new THREE.CatmullRomCurve3(points.map(([x, z]) => new THREE.Vector3(x, -0.03, z)));
    const tube = new THREE.TubeGeometry(curve, 90, 0.0008, 6);
    return new THREE.Mesh(tube, new THREE.MeshBasicMaterial({ color: colour }));
  }

  function light(scene) {
    const lights = [new THREE.HemisphereLight(0xffffff, 0x9a9fa8, 2.2)];
    for (const [x, y, z, strength] of [
      [0.6, -1, 1.2, 1.6],
      [-1, 0.6, 0.4, 0.5],
    ]) {
      const lamp = new THREE.DirectionalLight(0xffffff, strength);
      lamp.position.set(x, y, z);
      lights.push(lamp);
    }
    for (const lamp of lights) {
      lamp.layers.enable(SKIN_LAYER);
      scene.add(lamp);
    }
  }

  /** The scene of a leg, and its frames by name. */
  function sceneOf(leg) {
    const scene = new THREE.Scene();
    light(scene);
    const frames = {};
    for (const name of Object.keys(leg.frames)) {
      frames[name] = new THREE.Group();
      frames[name].rotation.order = "XYZ";
      scene.add(frames[name]);
    }
    for (const part of leg.data.parts) frames[part.frame].add(...objectsOf(part));
    scene.add(...leg.data.centre_paths.map(path));
    return { scene, frames, cylinder: frames.cylinder.getObjectByName("cylinder").material };
  }

  /** Directions of a camera. `out` points towards the viewer, `right` to the right, `up` up. */
  function directions({ azimuth, elevation }) {
    const [ca, sa] = [Math.cos(azimuth), Math.sin(azimuth)];
    const [ce, se] = [Math.cos(elevation), Math.sin(elevation)];
    return {
      out: new THREE.Vector3(ce * sa, -ce * ca, se),
      right: new THREE.Vector3(ca, sa, 0),
      up: new THREE.Vector3(-se * sa, se * ca, ce),
    };
  }

  /** Place a camera so that all points fill its picture. */
  function fit(camera, points, orbit, aspect) {
    const { out, right, up } = directions(orbit);
    const slope = Math.tan((FIELD_DEG * Math.PI) / 360);
    const target = new THREE.Vector3();
    let distance = 1;
    for (let round = 0; round < 4; ++round) {
      const seen = points.map((point) => {
        const way = point.clone().sub(target);
        return [way.dot(right), way.dot(up), way.dot(out)];
      });
      distance = Math.max(
        ...seen.map(([x, y, z]) => z + Math.max(Math.abs(x) / aspect, Math.abs(y)) / slope),
      );
      const across = seen.map(([x, , z]) => x / (distance - z));
      const upwards = seen.map(([, y, z]) => y / (distance - z));
      const middle = (values) => (Math.min(...values) + Math.max(...values)) / 2;
      target.addScaledVector(right, middle(across) * distance);
      target.addScaledVector(up, middle(upwards) * distance);
    }
    camera.aspect = aspect;
    camera.up.copy(up);
    camera.position.copy(target).addScaledVector(out, (1.03 * distance) / orbit.zoom);
    camera.lookAt(target);
    camera.updateProjectionMatrix();
  }

  class StageSolid {
    /** `isSlow` means that the processor draws. Then only still pictures have smooth edges. */
    constructor(legs, isSlow) {
      this.stillPixels = isSlow ? 2 : 1;
      const antialias = !isSlow;
      this.renderer = new THREE.WebGLRenderer({ antialias, alpha: true, stencil: true });
      this.renderer.setClearColor(0xffffff, 0);
      this.camera = new THREE.PerspectiveCamera(FIELD_DEG, 1, 0.05, 30);
      this.items = legs.map((leg) => this._item(leg));
    }

    /** A drawing, or null where the browser has no WebGL. */
    static of(legs) {
      const context = document.createElement("canvas").getContext("webgl2");
      if (!context) return null;
      const information = context.getExtension("WEBGL_debug_renderer_info");
      const name = information ? context.getParameter(information.UNMASKED_RENDERER_WEBGL) : "";
      context.getExtension("WEBGL_lose_context")?.loseContext();
      try {
        return new StageSolid(legs, SOFTWARE.test(name));
      } catch {
        return null; // the browser refuses another WebGL canvas
      }
    }

    _item(leg) {
      const vectors = (points) => points.map((point) => new THREE.Vector3(...point));
      const { hull, joint_hull: joint } = leg.data;
      return { leg, ...sceneOf(leg), hull: vectors(hull), joint: vectors(joint) };
    }

    /** Move the parts of a leg to a state. */
    pose(index, state) {
      const { leg, frames, cylinder } = this.items[index];
      for (const [name, [x, z, turn]] of Object.entries(leg.poses(state))) {
        frames[name].position.set(x, 0, z);
        frames[name].rotation.y = -turn;
      }
      cylinder.color.copy(colourOf(leg.pressureColour(state.pressure)));
    }

    /** Draw a leg, or only its linkage, into a canvas. Return the function from x and z to pixels. */
    draw(index, canvas, orbit, onlyLinkage) {
      const { width, height } = canvas;
      const { scene, hull, joint } = this.items[index];
      this._grow(width, height);
      if (onlyLinkage) this.camera.layers.disable(SKIN_LAYER);
      else this.camera.layers.enable(SKIN_LAYER);
      fit(this.camera, onlyLinkage ? joint : hull, orbit, width / height);
      this.renderer.setViewport(0, 0, width, height);
      this.renderer.setScissor(0, 0, width, height);
      this.renderer.setScissorTest(true);
      this.renderer.render(scene, this.camera);
      const source = this.renderer.domElement;
      const target = canvas.getContext("2d");
      target.clearRect(0, 0, width, height);
      target.drawImage(source, 0, source.height - height, width, height, 0, 0, width, height);
      const seen = this.camera.projectionMatrix.clone().multiply(this.camera.matrixWorldInverse); // the camera moves on
      return (x, z) => {
        const at = new THREE.Vector3(x, 0, z).applyMatrix4(seen);
        return [(0.5 + 0.5 * at.x) * width, (0.5 - 0.5 * at.y) * height];
      };
    }

    _grow(width, height) {
      const { width: w, height: h } = this.renderer.domElement;
      if (width > w || height > h) {
        this.renderer.setSize(Math.max(width, w), Math.max(height, h), false);
      }
    }
  }

  return StageSolid;
})();
