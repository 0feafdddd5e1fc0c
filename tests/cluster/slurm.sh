#!/usr/bin/env bash
# Proves the slurm profile on a cluster of one machine, this one: a small demo cell through Slurm, and what happens to a
# job that is killed. Needs root and Debian; installs slurm-wlm and munge. Not part of `make test`.
#
#     sudo tests/cluster/slurm.sh [FOLDER]     FOLDER, zeroshop_slurm.SOMETHING, keeps the results; a new one under /tmp by default
set -euo pipefail

project=$(cd "$(dirname "$0")/../.." && pwd)
folder=${1:-$(mktemp -d /tmp/zeroshop_slurm.XXXXXX)}
case $folder in *zeroshop_slurm.*) ;; *) echo "error: the folder's name must begin with zeroshop_slurm. ($folder)" >&2; exit 1 ;; esac
mkdir -p "$folder"/{state,spool,run}
folder=$(cd "$folder" && pwd -P)
cell=results/demo/mustard_bottle/su_h/truth/2dgs
conf=/etc/slurm/slurm.conf
export PYTHONPATH=$project/src

if ! command -v slurmctld slurmd munged > /dev/null; then
  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -yq --no-install-recommends slurm-wlm munge
fi
"$project/.venv/bin/python" -c 'import snakemake_executor_plugin_slurm' 2> /dev/null \
  || { echo "error: Snakemake's plugin for Slurm is missing; run: .venv/bin/python -m pip install '.[slurm]'" >&2; exit 1; }

if [ -e "$conf" ] || [ -L "$conf" ] && [[ $(readlink "$conf" || true) != *zeroshop_slurm.*/slurm.conf ]]; then
  echo "error: this machine belongs to a cluster already ($conf); use one that does not" >&2
  exit 1
fi
cat > "$folder/slurm.conf" << CONF
ClusterName=one
SlurmctldHost=$(hostname -s)
SlurmUser=root
SlurmdUser=root
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/run/slurmctld.pid
SlurmdPidFile=$folder/run/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
ReturnToService=2
NodeName=$(hostname -s) CPUs=$(nproc) RealMemory=$(free -m | awk '/^Mem:/ {print int($2 * 0.9)}') State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF

mkdir -p /run/munge && chown munge: /run/munge
daemons=("$folder"/run/slurmd.pid "$folder"/run/slurmctld.pid)
munge -n > /dev/null 2>&1 || { munged --force && daemons+=(/run/munge/munged.pid); }
# At its usual place, since Snakemake's plugin takes SLURM_CONF away from its jobs.
ln -sfn "$folder/slurm.conf" "$conf"
slurmctld && slurmd
trap 'kill $(cat "${daemons[@]}") 2> /dev/null || true; rm -f "$conf"' EXIT
for _ in $(seq 30); do sinfo -h -o %t 2> /dev/null | grep -qE 'idle|mix|alloc' && break; sleep 1; done
echo "slurm: $(srun hostname) answers"

cat > "$folder/small.yaml" << CONFIG
capture: {image_width_px: 320, image_height_px: 240}
nvs: {2dgs: {train: {iterations: 60, image_width_px: 160, sh_degree: 0}, fuse: {voxels: 64, image_width_px: 160}}}
finish: {texture_size_px: 256, clean: {max_faces: 3000}}
CONFIG

# Through the profile; the status is asked for more often than a real cluster would like.
run() {
  "$project/.venv/bin/snakemake" --snakefile "$project/workflow/Snakefile" --directory "$folder" \
    --workflow-profile "$project/workflow/profiles/slurm" --configfile "$folder/small.yaml" \
    --max-threads "$(nproc)" --slurm-status-command squeue --slurm-init-seconds-before-status-checks 5 --seconds-between-status-checks 5 "$@"
}

echo "== one cell"
run "$cell/mesh.ply" 2>&1 | tee "$folder/cell.txt"
[ -s "$folder/$cell/mesh.ply" ]
echo "== submitted: $(grep -c 'has been submitted with SLURM jobid' "$folder/cell.txt") jobs"

# Kills a training of this folder, as the kernel does when memory runs out, $1 times.
killer() {
  local left=$1 pid
  while [ "$left" -gt 0 ]; do
    for pid in $(pgrep -f '^[^ ]*python -m zeroshop_steps.surface --method twodgs'); do
      [ "$(readlink "/proc/$pid/cwd")" = "$folder" ] || continue
      kill -9 "$pid" 2> /dev/null && left=$((left - 1)) && sleep 3
    done
    sleep 0.5
  done
}

echo "== a cell that fails is a row"
run "$cell/cell.csv" --config 'nvs={2dgs: {fuse: {min_views: 1000}}}' 2>&1 | tee "$folder/row.txt"
grep 'none.*surface.fuse: .*no surface that 1000 views see' "$folder/$cell/cell.csv"

long='nvs={2dgs: {train: {iterations: 300}}}'
echo "== a training that is killed once runs again"
rm -r "${folder:?}/$cell/splats"
killer 1 & hunter=$!
run "$cell/splats/splats.ply" --config "$long" 2>&1 | tee "$folder/once.txt"
wait "$hunter"
[ -s "$folder/$cell/splats/splats.ply" ]
grep -q 'Trying to restart job' "$folder/once.txt"

echo "== a training that is killed every time is a clear failure"
rm -r "${folder:?}/$cell/splats"
killer 99 & hunter=$!
status=0
run "$cell/splats/splats.ply" --config "$long" > "$folder/always.txt" 2>&1 || status=$?
kill "$hunter"
cat "$folder/always.txt"
[ "$status" -ne 0 ]
[ "$(grep -c 'Trying to restart job' "$folder/always.txt")" -eq 2 ]
asked=$(grep -o 'SLURM jobid [0-9]*' "$folder/always.txt" | grep -o '[0-9]*$' | xargs -n 1 scontrol show job | grep -o 'MinMemory[A-Za-z]*=[0-9A-Z.]*' | xargs)
echo "== memory asked for: $asked"
[ "$(tr ' ' '\n' <<< "$asked" | sort -u | wc -l)" -eq 3 ]
[ ! -e "$folder/$cell/splats/splats.ply" ]
grep -q 'was killed' "$folder/always.txt" "$folder"/.snakemake/slurm_logs -r
echo "== all as expected; everything lies in $folder"
