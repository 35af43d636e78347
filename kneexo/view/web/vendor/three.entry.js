// The parts of three.js that stage.js uses.
export {
  AmbientLight, BackSide, BoxGeometry, BufferGeometry, CapsuleGeometry, Color, CylinderGeometry,
  DirectionalLight, Group, HemisphereLight, Line, LineBasicMaterial, Mesh, MeshBasicMaterial,
  MeshStandardMaterial, NotEqualStencilFunc, PerspectiveCamera, ReplaceStencilOp, Scene,
  SphereGeometry, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
