#!/bin/sh
# Puts the swarm of a cluster's file on its nodes and starts it:  deploy/start.sh [CLUSTER.toml]
# `skein` is the one in the path, or the one that SKEIN names. Once: skein cluster keys -f CLUSTER.toml
file=${1:-cluster.toml}
skein=${SKEIN:-skein}
# Status 1: some hosts failed. The others fly.
"$skein" cluster install -f "$file"
status=$?
[ $status -le 1 ] || exit $status
exec "$skein" cluster up -f "$file"
