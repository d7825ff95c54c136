//! The status of a swarm, in one line: good, to be watched, or bad, with the reasons.

use std::collections::BTreeMap;

use skein_common::id::VehicleId;
use skein_common::state::{Activity, Membership, PeerStatus};
use skein_lab::metrics::COLLISION_M;

use super::snapshot::{Level, Status, Team, Vehicle, safety_distance_m};
use skein_cluster::display::status::{self, Known, Row};
use skein_cluster::mesh::order::ranges;

/// A vehicle of which the simulator delivers fewer frames a second flies worse.
const FEW_FRAMES_HZ: f64 = 45.0;
/// Largest number of reasons that are listed.
const MOST_REASONS: usize = 8;

/// The sources of a team's status: what does not change, what was observed, the rows of its table, and what the page shows.
pub(super) struct Judged<'a> {
    pub(super) team: &'a Team,
    pub(super) observed: &'a [Known],
    pub(super) rows: &'a [Row],
    pub(super) vehicles: &'a [Vehicle],
}

/// The status of a swarm, or of all teams of a fleet.
pub(super) fn status(teams: &[Judged<'_>]) -> Status {
    let rows: Vec<Row> = teams.iter().flat_map(|judged| judged.rows.iter().cloned()).collect();
    let mut reasons: Vec<(Level, String)> = teams.iter().flat_map(reasons_of).collect();
    reasons.extend(near_pairs(teams));
    reasons.sort_by_key(|(level, _)| std::cmp::Reverse(*level));
    let level = reasons.first().map_or(Level::Ok, |(level, _)| *level);
    let more = reasons.len().saturating_sub(MOST_REASONS);
    let mut reasons: Vec<String> = reasons.into_iter().take(MOST_REASONS).map(|(_, reason)| reason).collect();
    if more > 0 {
        reasons.push(format!("and {more} more"));
    }
    Status { level, text: line(teams, &rows), reasons }
}

/// `8/8 in formation · step 2 of 6 · worst gap 3.1° · nearest 22.0 m · oldest message 180 ms`
fn line(teams: &[Judged<'_>], rows: &[Row]) -> String {
    let has_gaps =
        teams.iter().all(|judged| status::has_gaps(&judged.team.scenario, judged.rows.iter().find_map(|row| row.step)));
    let steps = || rows.iter().filter_map(|row| row.step);
    let last = teams.iter().map(|judged| judged.team.scenario.mission.steps.len().saturating_sub(1)).max().unwrap_or(0);
    let step = steps().min().zip(steps().max()).filter(|_| last > 0).map(|(least, most)| match least == most {
        true => format!("step {least} of {last}"),
        false => format!("steps {least} to {most} of {last}"),
    });
    let nearest =
        teams.iter().flat_map(|judged| judged.vehicles).filter_map(|vehicle| vehicle.nearest_m).reduce(f64::min);
    let oldest = rows.iter().filter_map(|row| row.facts.get("peer_age_ms")).reduce(f64::max);
    let parts = [
        Some(status::phases(rows)).filter(|_| !rows.is_empty()),
        step,
        status::worst_gap_deg(rows, has_gaps).map(|off_deg| format!("worst gap {off_deg:.1}°")),
        nearest.map(|nearest_m| format!("nearest {nearest_m:.1} m")),
        oldest.map(|age_ms| format!("oldest message {age_ms:.0} ms")),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(" · ")
}

/// The faults of one team.
fn reasons_of(judged: &Judged<'_>) -> Vec<(Level, String)> {
    let mut reasons = Vec::new();
    for (known, vehicle) in judged.observed.iter().zip(judged.vehicles) {
        let id = &vehicle.id;
        let Some((sample, silent)) = &known.newest else {
            reasons.push((Level::Warn, format!("vehicle {id}: nothing received yet")));
            continue;
        };
        if !vehicle.contact {
            // It ended after its flight.
            if sample.activity != Activity::Landed && sample.membership != Membership::Left {
                reasons.push((Level::Bad, format!("vehicle {id}: silent for {:.0} s", silent.as_secs_f64())));
            }
            continue;
        }
        reasons.extend(sample.failures.iter().map(|failure| (Level::Bad, format!("vehicle {id}: {failure}"))));
        if sample.activity == Activity::Blind {
            reasons.push((Level::Bad, format!("vehicle {id}: no data from its simulator")));
        }
        let rate_hz = sample.process.map(|process| process.frame_rate_hz);
        if let Some(rate_hz) = rate_hz.filter(|rate_hz| (0.1..FEW_FRAMES_HZ).contains(rate_hz)) {
            reasons.push((
                Level::Warn,
                format!("vehicle {id}: {rate_hz:.0} frames a second, fewer than {FEW_FRAMES_HZ:.0}"),
            ));
        }
    }
    reasons.extend(partitions(judged));
    reasons
}

/// Vehicles in contact with this observer that are not in contact with each other.
fn partitions(judged: &Judged<'_>) -> Vec<(Level, String)> {
    let team = judged.team.id().map_or_else(String::new, |team| format!("team {team}: "));
    let there: Vec<_> = judged.observed.iter().filter_map(|vehicle| Some((vehicle.id, vehicle.flying()?))).collect();
    let there = there.iter().filter(|(_, sample)| sample.membership == Membership::Active);
    let members: BTreeMap<VehicleId, _> = there.map(|(id, sample)| (*id, *sample)).collect();
    let mut reasons = Vec::new();
    let mut parts: Vec<Vec<VehicleId>> = Vec::new();
    let standing = |to: &VehicleId, from: &VehicleId| {
        let peer = members.get(to)?.peers.iter().find(|peer| peer.id == *from)?;
        Some(peer.standing)
    };
    let receives =
        |to: &VehicleId, from: &VehicleId| standing(to, from).is_some_and(|standing| standing != PeerStatus::Lost);
    let lost = |to: &VehicleId, from: &VehicleId| standing(to, from) == Some(PeerStatus::Lost);
    // Each part grows from one vehicle by those that are linked with any in it.
    let mut left: Vec<VehicleId> = members.keys().copied().collect();
    while let Some(first) = left.pop() {
        let (mut part, mut nth) = (vec![first], 0);
        while let Some(one) = part.get(nth).copied() {
            left.retain(|other| {
                let is_linked = receives(&one, other) || receives(other, &one);
                if is_linked {
                    part.push(*other);
                }
                !is_linked
            });
            nth += 1;
        }
        part.sort_unstable();
        parts.push(part);
    }
    if parts.len() > 1 {
        parts.sort();
        let shown: Vec<_> = parts.iter().map(|part| ranges(part)).collect();
        reasons.push((Level::Bad, format!("{team}{} partitions: {}", parts.len(), shown.join(" | "))));
    }
    let pairs = members.keys().flat_map(|to| members.keys().map(move |from| (to, from)));
    for (to, from) in pairs.filter(|(to, from)| lost(to, from) && receives(from, to)) {
        reasons.push((Level::Warn, format!("{team}vehicle {to} does not receive vehicle {from}")));
    }
    reasons
}

/// Pairs in the air that are too near to each other.
fn near_pairs(teams: &[Judged<'_>]) -> Vec<(Level, String)> {
    let safety_m = |judged: &Judged<'_>, nth: usize| {
        let newest = judged.observed.get(nth).and_then(|vehicle| vehicle.newest.as_ref());
        let (step, settings) =
            newest.map_or((0, [].as_slice()), |(sample, _)| (sample.step, sample.settings.as_slice()));
        safety_distance_m(&*judged.team.scenario.formation_with(step, settings)?)
    };
    let mut reasons = Vec::new();
    for judged in teams {
        for (nth, vehicle) in judged.vehicles.iter().enumerate().filter(|(_, vehicle)| vehicle.is_airborne()) {
            let (Some(distance_m), Some(other)) = (vehicle.nearest_m, &vehicle.nearest) else { continue };
            let is_second = teams.iter().flat_map(|judged| judged.vehicles).any(|first| {
                first.id == *other && first.nearest.as_ref() == Some(&vehicle.id) && first.id < vehicle.id
            });
            if is_second {
                continue;
            }
            let pair = format!("vehicles {} and {other}: {distance_m:.1} m apart", vehicle.id);
            if distance_m < COLLISION_M {
                reasons.push((Level::Bad, format!("{pair}, a collision")));
            } else if let Some(safety_m) = safety_m(judged, nth).filter(|safety_m| distance_m < *safety_m) {
                reasons.push((Level::Warn, format!("{pair}, less than the safety distance of {safety_m} m")));
            }
        }
    }
    reasons
}
