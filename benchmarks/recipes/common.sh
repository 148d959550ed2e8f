# shellcheck shell=bash disable=SC2034  # the recipes use what is set here
# What the recipes share. Each is called as METHOD.sh [--dry-run] SCENE [ROOT]; see docs/models.md. ROOT is the folder of
# paper.toml (`msb run --example paper`), and all files below it have the names that paper.toml expects.
#
# A recipe defines make_environment and train_model, and then calls `begin` and `once`. A finished step leaves a mark, so
# that a second start goes on after the last one. Code and environment of a method are made once for all scenes.

set -euo pipefail

dry=no
if [ "${1:-}" = --dry-run ]; then
  dry=yes
  shift
fi
if [ $# -lt 1 ] || [ $# -gt 2 ]; then
  echo "usage: $(basename "$0") [--dry-run] SCENE [ROOT]" >&2
  exit 2
fi

fail() {
  echo "$(basename "$0"): $1" >&2
  exit 3
}

[ -d "$1" ] || fail "$1: this folder does not exist; pass the folder of a scene"
here=$(cd "$(dirname "$0")" && pwd)
scene=$(cd "$1" && pwd)
name=$(basename "$scene")
root=$(realpath -m "${2:-.}")
method=$(basename "$0" .sh)
# images, divisor: the photographs of the protocol and their size relative to images/. flags: of code derived from 3DGS.
kind=colmap where=outdoor images=images divisor=1 flags=(--eval)
case $name in
  bicycle | flowers | garden | stump | treehill) dataset=mipnerf360 images=images_4 divisor=4 ;;
  room | counter | kitchen | bonsai) dataset=mipnerf360 where=indoor images=images_2 divisor=2 ;;
  train | truck) dataset=tanksandtemples ;;
  chair | drums | ficus | hotdog | lego | materials | mic | ship)
    dataset=nerf_synthetic kind=synthetic where=object images=test divisor=2 flags=(--eval -w -r 2)
    ;;
  scan[0-9]*) dataset=dtu where=object flags=(--eval -w) ;;
  *) fail "$name is not a scene of the paper's four datasets; the official scripts have arguments for these alone" ;;
esac
if [ $kind = colmap ]; then
  [ -d "$scene/sparse/0" ] || fail "$scene: it is not a COLMAP scene, because it has no folder sparse/0"
else
  [ -f "$scene/transforms_train.json" ] || fail "$scene: it is not a scene of NeRF-Synthetic, because it has no transforms_train.json"
fi
[ -d "$scene/$images" ] || fail "$scene: it has no folder $images, which the official script needs"

code=$root/code/$method env=$root/env/$method model=$root/output/$method/$dataset/$name
renders=$root/renders/$method/$dataset/$name
track=$root/training/$method/$dataset/$name.json timing=$root/timing/$method/$dataset/$name.json

# Print a command, and run it unless the run is dry.
run() {
  printf '+'
  printf ' %q' "$@"
  printf '\n'
  [ $dry = yes ] || "$@"
}

# The same in a folder of the code and in the method's environment.
inside() {
  local folder=$1
  shift
  run env -C "$code/$folder" conda run --no-capture-output -p "$env" "$@"
}

# Do a step unless its mark exists. The marks are files in the folders that the steps write.
once() {
  local mark=$1
  shift
  if [ -e "$mark" ]; then
    echo "# finished earlier: $*"
    return
  fi
  "$@"
  run mkdir -p "$(dirname "$mark")"
  run touch "$mark"
}

clone() {
  run rm -rf "$code"
  run git clone --recursive "$1" "$code"
  run git -C "$code" checkout "$2"
  run git -C "$code" submodule update --init --recursive
}

# Check the machine, and get code and environment of the method.
begin() {
  local tool
  echo "NOT TRIED: written from the official code, on a machine without CUDA"
  for tool in git conda nvidia-smi nvcc msb; do
    if ! command -v "$tool" >/dev/null; then
      [ $dry = yes ] || fail "$tool is needed and not there"
      echo "missing here: $tool"
    fi
  done
  once "$root/code/.$method" clone "$1" "$2"
  once "$env/.ready" make_environment
}

# Write the photographs of `scene` to FOLDER, smaller by DIVISOR and over white, as images or images_4, and use that scene.
prepare() {
  local prepared=$root/prepared/$1/$dataset/$name
  once "$prepared/.ready" shrink "$prepared" "$2" "$3"
  scene=$prepared
}

shrink() {
  run mkdir -p "$1/$2"
  run ln -sfn "$scene/sparse" "$1/sparse"
  inside . python "$here/shrink.py" "$scene/images" "$1/$2" "$3"
}

# Run the training in the environment under `msb track`, whose record a protocol takes as `training`.
train() {
  run mkdir -p "$(dirname "$track")" "$(dirname "$model")"
  run env -C "$code" msb track --force -o "$track" -- conda run --no-capture-output -p "$env" "$@"
}

# Render the test views with the official evaluation, time its renderer, and write the timing.
evaluate() {
  run mkdir -p "$(dirname "$timing")"
  inside . python "$here/official.py" "$method" "$timing" "$@"
}
