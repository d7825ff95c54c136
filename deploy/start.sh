#!/bin/sh
# Installs a swarm on the nodes of a cluster file and starts it:  deploy/start.sh [CLUSTER.toml]
# `skein` is found in PATH, or named by the variable SKEIN. First, once: skein cluster keys -f CLUSTER.toml
file=${1:-cluster.toml}
skein=${SKEIN:-skein}
# Status 1: some hosts failed. The others can fly.
"$skein" cluster install -f "$file"
status=$?
[ $status -le 1 ] || exit $status
exec "$skein" cluster up -f "$file"
