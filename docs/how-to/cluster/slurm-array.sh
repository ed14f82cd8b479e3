#!/bin/sh
#SBATCH --job-name=tactus-set
#SBATCH --array=0-39%10
#SBATCH --cpus-per-task=2
#SBATCH --time=01:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
# SIGTERM to this script a minute before the time is over: the cases in work are completed
#SBATCH --signal=B:TERM@60

# The folder for the set; every node must see it. SEED and CASES are the same for all shards.
SET="${SET:-/shared/set}"
SEED="${SEED:-1}"
CASES="${CASES:-1000000}"
SHARDS="${SHARDS:-40}"
export RAYON_NUM_THREADS="${SLURM_CPUS_PER_TASK:-1}"

tactus-lab dataset --shard "$SLURM_ARRAY_TASK_ID/$SHARDS" --seed "$SEED" --cases "$CASES" --out "$SET" &
child=$!
trap 'kill -TERM "$child"' TERM
wait "$child"
code=$?
# a signal ends the first wait before the program has ended
while kill -0 "$child" 2>/dev/null; do
    wait "$child"
    code=$?
done

# 75: stopped, or made by another process. Above 128: a signal. Both continue; 2 and 78 would fail again.
if [ "$code" -eq 75 ] || [ "$code" -gt 128 ]; then
    if [ "${SLURM_RESTART_COUNT:-0}" -lt 5 ]; then
        scontrol requeue "$SLURM_JOB_ID"
    fi
fi
exit "$code"
