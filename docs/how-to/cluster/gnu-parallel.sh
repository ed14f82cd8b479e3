#!/bin/sh
# Shards on this machine, or with --sshlogin on several that see the same folder. Run it again: complete shards are kept.
set -eu
SET="${SET:-set}"
SEED="${SEED:-1}"
CASES="${CASES:-1000000}"
SHARDS="${SHARDS:-40}"
JOBS="${JOBS:-4}"
export RAYON_NUM_THREADS="${RAYON_NUM_THREADS:-1}"

# --retries would also repeat 2 and 78; this repeats 75 and signals, five times at most
export SET SEED CASES SHARDS
parallel --jobs "$JOBS" --halt soon,fail=1 '
    for attempt in 1 2 3 4 5; do
        code=0
        tactus-lab dataset --shard {}/"$SHARDS" --seed "$SEED" --cases "$CASES" --out "$SET" || code=$?
        [ "$code" -eq 75 ] || [ "$code" -gt 128 ] || exit "$code"
        sleep 5
    done
    exit "$code"
' ::: $(seq 0 $((SHARDS - 1)))
