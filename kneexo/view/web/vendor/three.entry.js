// The parts of three.js that stage_solid.js uses.
export {
  BoxGeometry, CapsuleGeometry, CatmullRomCurve3, Color, CylinderGeometry, DirectionalLight, Group,
  HemisphereLight, Mesh, MeshBasicMaterial, MeshLambertMaterial, NotEqualStencilFunc,
  PerspectiveCamera, ReplaceStencilOp, SRGBColorSpace, Scene, SphereGeometry, TubeGeometry, Vector3,
  WebGLRenderer,
} from "three";
