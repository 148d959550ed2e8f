# shellcheck shell=bash disable=SC2034  # the recipes use what is set here
# What the recipes share. Each is called as METHOD.sh [--dry-run] SCENE OUT; see docs/models.md.
# A recipe sets repository, commit and environment, and then calls `run` and `inside` for each step.

set -euo pipefail

dry=no
if [ "${1:-}" = --dry-run ]; then
  dry=yes
  shift
fi
if [ $# -ne 2 ]; then
  echo "usage: $(basename "$0") [--dry-run] SCENE OUT" >&2
  exit 2
fi

fail() {
  echo "$(basename "$0"): $1" >&2
  exit 3
}

[ -d "$1/sparse/0" ] || fail "$1: it is no COLMAP scene: there is no sparse/0 in it"
scene=$(cd "$1" && pwd)
name=$(basename "$scene")
case $name in
  bicycle | flowers | garden | stump | treehill) where=outdoor images=images_4 divisor=4 ;;
  room | counter | kitchen | bonsai) where=indoor images=images_2 divisor=2 ;;
  train | truck) where=outdoor images=images divisor=1 ;;
  *) fail "$name is no scene of Mip-NeRF 360 or Tanks and Temples; the official scripts have arguments for these alone" ;;
esac
out=$(realpath -m "$2")
code=$out/code env=$out/env model=$out/model renders=$out/renders

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

# Check the machine, get the code at the commit that the adapters were written for, and make the folder.
# No recipe was run where this was written: there was no CUDA. The arguments are those of the official scripts.
begin() {
  local repository=$1 commit=$2 tool
  [ -d "$scene/$images" ] || fail "$scene: there is no $images in it, which the official script takes"
  echo "NOT TRIED: written from the official code's own scripts, on a machine without CUDA"
  for tool in git conda nvidia-smi nvcc msb; do
    if ! command -v "$tool" >/dev/null; then
      [ $dry = yes ] || fail "$tool is needed and not there"
      echo "missing here: $tool"
    fi
  done
  run mkdir -p "$out"
  run git clone --recursive "$repository" "$code"
  run git -C "$code" checkout "$commit"
  run git -C "$code" submodule update --init --recursive
}

# Run the training in the environment under `msb track`, whose record a protocol takes as `training`.
train() {
  run env -C "$code" msb track -o "$out/track.json" -- conda run --no-capture-output -p "$env" "$@"
}

# Say what a protocol needs to know of the result.
finish() {
  cat <<TOML
# for a protocol of msb run:
[[methods]]
name = "$1"
model = "$2"
training = "$out/track.json"
non_engine = "$3"
TOML
}
