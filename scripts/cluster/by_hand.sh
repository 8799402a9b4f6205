#!/usr/bin/env bash
# A night on several machines, started by hand.    scripts/cluster/by_hand.sh SITE.yaml MACHINE...
# Each MACHINE is reached by ssh, has the same wbflow[dask] at the same place, and the site's folder under the same name
# (else add  --worker-root HERE=THERE  to the last command).  WORKERS: workers on each machine (default 4).
set -euo pipefail
site="$1"
shift
here="$(hostname -I | cut -d' ' -f1)"
bin="$(dirname "$(command -v wbflow)")"
started=()
trap 'kill "${started[@]}" 2>/dev/null || true' EXIT

"$bin/dask" scheduler --host "$here" --port 8786 --no-dashboard &
started+=($!)
for machine in "$@"; do
  # -tt: the workers end when the connection does
  ssh -tt "$machine" "$bin/dask" worker "tcp://$here:8786" --nworkers "${WORKERS:-4}" --nthreads 1 --no-dashboard </dev/null &
  started+=($!)
done
for _ in $(seq 30); do # the first worker may need a moment
  "$bin/python" -c "import sys, distributed; sys.exit(not distributed.Client('tcp://$here:8786', timeout=5).nthreads())" \
    2>/dev/null && break
  sleep 2
done
"$bin/wbflow" run "$site" --backend dask --scheduler "tcp://$here:8786"
