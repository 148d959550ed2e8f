#!/usr/bin/env bash
# Trains 2DTS on one scene with its official code. Needs CUDA 12.4 or newer, and CUDA_HOME.
# Its runner trains all scenes of a dataset; here its function for one is called. It writes no test views, so
# Non-Engine is our reference renderer.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

# The configs start from a dense point cloud, which no dataset has: the centres of a 3DGS model of the scene, as
# its authors write, or a dense COLMAP reconstruction.
[ -f "$scene/sparse/0/point_cloud.ply" ] ||
  fail "$scene/sparse/0/point_cloud.ply is not there: 2DTS starts from a dense point cloud; see docs/models.md"
case $name in
  train | truck) config=TanksAndBlending ;;
  *) config=MipNerf360 ;;
esac

begin https://github.com/GaodeRender/triangle-splatting 54c80f7
run conda create -y -p "$env" python=3.12
inside . pip install -r requirements.txt --no-cache-dir
inside . pip install . --no-cache-dir
train python -c 'import sys
from run_experiments import exp
exp(sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]), 0)' \
  "config/${config}_VanillaTS.yaml" "$(dirname "$scene")" "$name" "$divisor"
run ln -s "$code/outputs/$config/VanillaTS/$name" "$model"
finish two_dts "$model" reference
