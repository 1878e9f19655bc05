// The rig from its file's lengths and masses: solid as measured, transparent where its setpoint is, and blue where a
// twin is that flew by itself for the last two seconds.
import * as THREE from "./vendor/three.js";

const USUAL = { L_a: 0.64, L_b: 0.45, L_h: 0.275, L_phi: 0.03, L_theta: 0.03, M_f: 0.355, M_b: 0.355, M_w: 1.565, elevation_min: -25 };
const DENSITY_KG_M3 = 7800;
const UP = new THREE.Vector3(0, 1, 0);

function edge(mass) { return Math.cbrt(Math.max(mass, 0.02) / DENSITY_KG_M3); }

export class Scene {
  constructor(holder, rig) {
    this.holder = holder;
    this.rig = { ...USUAL, ...rig };
    this.drawnMs = 0;
    this.shown = "";
    try {
      this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, powerPreference: "low-power" });
    } catch {
      holder.textContent = "The rig cannot be drawn: this browser has no WebGL. Everything else works.";
      return;
    }
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    holder.replaceChildren(this.renderer.domElement);
    const r = this.rig;
    this.height = (r.L_a + 0.05) * Math.sin((-r.elevation_min * Math.PI) / 180) + r.L_theta + 0.03;
    this.scene = new THREE.Scene();
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8899aa, 2.2));
    const sun = new THREE.DirectionalLight(0xffffff, 1.8);
    sun.position.set(1, 3, 2);
    this.scene.add(sun);
    this.scene.add(new THREE.GridHelper(2, 10, 0x8a9aa8, 0xbcc8d2));
    const column = new THREE.Mesh(new THREE.CylinderGeometry(0.018, 0.03, this.height), new THREE.MeshStandardMaterial({ color: 0x5b6772 }));
    column.position.y = this.height / 2;
    this.scene.add(column);
    this.solid = this.arm(1);
    this.ghost = this.arm(0.28, 0xb45f06);
    this.twin = this.arm(0.38, 0x1155cc);
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.1, 20);
    this.centre = 0; // travel around which the camera looks [rad]
    this.resize();
    new ResizeObserver(() => this.resize()).observe(holder);
  }

  arm(opacity, tint = null) {
    const r = this.rig, ghost = opacity < 1;
    const material = (color) => new THREE.MeshStandardMaterial({ color: ghost ? tint : color, opacity, transparent: ghost, depthWrite: !ghost });
    const box = (x, y, z, color, at) => {
      const mesh = new THREE.Mesh(new THREE.BoxGeometry(x, y, z), material(color));
      mesh.position.set(...at);
      return mesh;
    };
    // Long arm along x, counterweight at -x; the short arm lies across it, front at +z.
    const travel = new THREE.Group(), elevation = new THREE.Group(), pitch = new THREE.Group();
    travel.position.y = this.height;
    travel.add(elevation);
    elevation.add(pitch);
    elevation.add(box(r.L_a + r.L_b, 0.016, 0.016, 0x33475b, [(r.L_a - r.L_b) / 2, -r.L_theta, 0]));
    const weight = edge(r.M_w) * 1.6;
    elevation.add(box(weight, weight, weight, 0x7a4b00, [-r.L_b, -r.L_theta, 0]));
    pitch.position.set(r.L_a, -r.L_theta, 0);
    pitch.add(box(0.014, 0.014, 2 * r.L_h, 0x33475b, [0, -r.L_phi, 0]));
    for (const [sign, mass, color] of [[1, r.M_f, 0x14602c], [-1, r.M_b, 0x741b47]]) {
      const size = edge(mass) * 1.4;
      pitch.add(box(size, size, size, color, [0, -r.L_phi, sign * r.L_h]));
      const disc = new THREE.Mesh(new THREE.CylinderGeometry(0.1, 0.1, 0.004, 32), material(color));
      disc.material.transparent = true;
      disc.material.opacity = 0.35 * opacity;
      disc.position.set(0, -r.L_phi + size, sign * r.L_h);
      pitch.add(disc);
    }
    this.scene.add(travel);
    return { travel, elevation, pitch };
  }

  resize() {
    const width = this.holder.clientWidth || 1, height = this.holder.clientHeight || 1;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.frame();
    this.shown = "";
  }

  // Place the camera so that all that the rig reaches around the present travel fills the panel.
  frame() {
    const r = this.rig, camera = this.camera, points = [];
    for (const turn of [-0.6, -0.3, 0, 0.3, 0.6])
      for (const tilt of [r.elevation_min * Math.PI / 180, 0, 0.3])
        for (const [x, z] of [[r.L_a + 0.1, r.L_h + 0.1], [r.L_a + 0.1, -r.L_h - 0.1], [-r.L_b - 0.05, 0]]) {
          const at = new THREE.Vector3(x * Math.cos(tilt), x * Math.sin(tilt) + this.height, z);
          points.push(at.applyAxisAngle(UP, this.centre + turn));
        }
    points.push(new THREE.Vector3(0, 0, 0));
    const box = new THREE.Box3().setFromPoints(points), target = box.getCenter(new THREE.Vector3());
    // A tall panel shows the rig from above, a wide panel from the side.
    const rise = camera.aspect < 0.8 ? 0.85 : camera.aspect < 1.2 ? 0.6 : 0.4, side = 0.4;
    const from = new THREE.Vector3(Math.sin(side) * Math.cos(rise), Math.sin(rise), Math.cos(side) * Math.cos(rise));
    let far = 6;
    for (let pass = 0; pass < 8; pass++) {
      camera.position.copy(target).addScaledVector(from, far);
      camera.lookAt(target);
      camera.updateMatrixWorld();
      camera.updateProjectionMatrix();
      const seen = new THREE.Box3().setFromPoints(points.map((point) => point.clone().project(camera)));
      const half = Math.tan((camera.fov * Math.PI) / 360) * far, shift = seen.getCenter(new THREE.Vector3());
      const right = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 0), up = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 1);
      target.addScaledVector(right, shift.x * half * camera.aspect).addScaledVector(up, shift.y * half);
      far *= Math.max(seen.max.x - seen.min.x, seen.max.y - seen.min.y) / 2 / 0.97;
    }
    this.shown = "";
  }

  // Angles [rad]: elevation, pitch, travel.
  draw(nowMs, intervalMs, measured, setpoint, flies, twin) {
    if (!this.renderer || nowMs - this.drawnMs < intervalMs || document.hidden) return;
    if (Math.abs(measured[2] - this.centre) > 0.6) { this.centre = measured[2]; this.frame(); }
    const shown = [...measured, ...setpoint, ...(twin ?? []), flies].map((v) => (typeof v === "number" ? v.toFixed(4) : v)).join();
    if (shown === this.shown) return;
    this.shown = shown;
    this.drawnMs = nowMs;
    pose(this.solid, measured);
    this.ghost.travel.visible = flies;
    if (flies) pose(this.ghost, setpoint);
    this.twin.travel.visible = twin !== null;
    document.getElementById("ghost-setpoint").hidden = !flies;
    document.getElementById("ghost-twin").hidden = twin === null;
    if (twin) pose(this.twin, twin);
    this.renderer.render(this.scene, this.camera);
  }
}

function pose(arm, [elevation, pitch, travel]) {
  arm.travel.rotation.y = travel || 0;
  arm.elevation.rotation.z = elevation || 0;
  arm.pitch.rotation.x = -pitch || 0;
}
