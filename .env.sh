export PYTHONPATH=/tmp/w/servo:/tmp/w/servo/models:/tmp/w/servo/envs:/tmp/w/servo/leaderboard OMP_NUM_THREADS=1
PY=/work/main/.venv/bin/python
cd /tmp/w/servo
