// three.js: its renderer and glTF loader as its documentation begins with them.
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { MeshoptDecoder } from "three/addons/libs/meshopt_decoder.module.js";

obey(async (canvas, file) => {
  const renderer = new THREE.WebGLRenderer({ canvas });
  const loader = new GLTFLoader();
  loader.setMeshoptDecoder(MeshoptDecoder);
  const scene = new THREE.Scene();
  scene.add((await loader.loadAsync(file)).scene);
  return (view) => {
    const camera = new THREE.PerspectiveCamera(view.degrees, canvas.width / canvas.height, view.near, view.far);
    camera.position.set(...view.eye);
    camera.lookAt(...view.target);
    renderer.render(scene, camera);
  };
});
