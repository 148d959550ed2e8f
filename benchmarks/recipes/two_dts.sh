#!/usr/bin/env bash
# Trains 2DTS on one scene with its official code, and renders and times the test views. Needs CUDA 12.4, and CUDA_HOME.
# Its configs start from a dense point cloud, which no dataset has: the centres of a 3DGS model of the scene, as its authors
# write. A cloud in the scene is used; otherwise three_dgs.sh makes the model first. DTU uses the config of Mip-NeRF 360.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

cloud=sparse/0/point_cloud.ply config=MipNerf360
case $dataset in
  tanksandtemples) config=TanksAndBlending ;;
  nerf_synthetic) config=NerfSynthetic cloud=point_cloud.ply ;;
esac

make_environment() {
  run conda create -y -p "$env" python=3.12
  inside . pip install -r requirements.txt --no-cache-dir
  inside . pip install . --no-cache-dir
}
# Make a scene of links whose dense cloud is that of 3DGS; the dataset stays as it is.
link_scene() {
  local linked=$1 gaussians=$root/output/three_dgs/$dataset/$name/point_cloud/iteration_30000/point_cloud.ply file
  run mkdir -p "$linked/$(dirname "$cloud")"
  for file in "$scene"/* "$scene"/sparse/0/*; do
    [ ! -e "$file" ] || [ "$(basename "$file")" = sparse ] || run ln -sfn "$file" "$linked/${file#"$scene"/}"
  done
  run ln -sfn "$gaussians" "$linked/$cloud"
}
train_model() {
  train python -c 'import sys
from run_experiments import exp
exp(sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]), 0)' \
    "config/${config}_VanillaTS.yaml" "$(dirname "$scene")" "$name" "$divisor"
  run ln -sfn "$code/outputs/$config/VanillaTS/$name" "$model"
}

if [ ! -f "$scene/$cloud" ] && [ ! -f "$root/output/three_dgs/$dataset/$name/.trained" ]; then
  option=()
  [ $dry = no ] || option=(--dry-run)
  "$here/three_dgs.sh" "${option[@]}" "$scene" "$root"
fi
begin https://github.com/GaodeRender/triangle-splatting 54c80f7
[ $dataset != dtu ] || prepare halved images 2
if [ ! -f "$scene/$cloud" ]; then
  linked=$root/prepared/dense/$dataset/$name
  once "$linked/.ready" link_scene "$linked"
  scene=$linked
fi
once "$model.trained" train_model
once "$model.rendered" evaluate "config/${config}_VanillaTS.yaml" "$scene" "$divisor" "$model" "$renders"
