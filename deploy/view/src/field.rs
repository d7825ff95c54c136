//! The formation field around a vehicle: what its law would command at the points of a grid, with what the vehicle observes.

use nalgebra::Vector3;
use serde::Serialize;
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::Law;
use skein_common::state::PeerStatus;
use skein_core::formation::law::{Goal, LawCommand, Neighbour, Observation};
use skein_core::formation::laws;

use super::snapshot::{Team, rounded};
use skein_cluster::display::status::Known;

/// Points on a side of the grid.
const POINTS: usize = 21;
/// Half a side of the grid, as a multiple of the formation's outer edge.
const REACH: f64 = 1.5;

/// The field around one vehicle at the points of a grid.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Field {
    /// The vehicle.
    pub(super) vehicle: String,
    /// North of the points, m: one for each row.
    pub(super) north_m: Vec<f64>,
    /// East of the points, m: one for each column.
    pub(super) east_m: Vec<f64>,
    /// The command at each point, north and east, row by row: a field without unit, a displacement in m, or a velocity in m/s.
    pub(super) ne: Vec<[f64; 2]>,
}

/// The field of a vehicle of this team; `observed` are the team's vehicles, of which it observes those in contact with it. `None` if
/// the law cannot be evaluated alone, or the vehicle is not in contact.
pub(super) fn field(team: &Team, observed: &[Known], own: VehicleId) -> Option<Field> {
    let sample = |id: VehicleId| observed.iter().find(|vehicle| vehicle.id == id)?.flying();
    let own_sample = sample(own)?;
    let step = own_sample.step as usize;
    let formation = &*team.scenario.formation_with(own_sample.step, &own_sample.settings)?;
    if formation.law == Law::External {
        return None;
    }
    let law = laws::make(&team.scenario, formation, own).ok()?;
    let in_contact = || own_sample.peers.iter().filter(|peer| peer.standing != PeerStatus::Lost);
    let neighbours: Vec<Neighbour> = in_contact()
        .filter_map(|peer| {
            let sample = sample(peer.id)?;
            Some(Neighbour {
                id: peer.id,
                position: sample.place(),
                velocity: sample.velocity,
                heading_rad: sample.attitude.heading_rad,
                age_s: f64::from(peer.age_ms) / 1e3,
                is_fresh: peer.standing == PeerStatus::Fresh,
            })
        })
        .collect();
    let members: VehicleSet = in_contact().map(|peer| peer.id).collect();
    let [north_m, east_m] = own_sample.centre_ne_m;
    let centre = PositionNed::new(north_m, east_m, -formation.altitude_m);
    let reach_m = REACH * (formation.radius_m / formation.gamma.sqrt().min(1.0) + formation.outer_width_m);
    let offsets_m: Vec<f64> = (0..POINTS).map(|nth| (2.0 * nth as f64 / (POINTS - 1) as f64 - 1.0) * reach_m).collect();
    let at = |north_m: f64, east_m: f64| {
        let position = centre + Vector3::new(north_m, east_m, own_sample.place().down_m() - centre.down_m());
        let observation = Observation {
            own,
            position,
            velocity: own_sample.velocity,
            heading_rad: own_sample.attitude.heading_rad,
            neighbours: &neighbours,
            members,
            obstacles: &[],
            goal: Goal {
                step,
                centre,
                centre_velocity: VelocityNed::default(),
                heading_rad: formation.heading_rad(),
                radius_m: formation.radius_m,
                gamma: formation.gamma,
            },
            dt_s: 0.0,
        };
        // A copy, so that no point changes the law's memory for the next.
        let ne = match law.clone().update(&observation).command {
            LawCommand::Field(field) => [field.x, field.y],
            LawCommand::Displacement(ne_m) => [ne_m.x, ne_m.y],
            LawCommand::Velocity { ne_m_s, .. } => [ne_m_s.x, ne_m_s.y],
        };
        ne.map(rounded)
    };
    // A grid of the fleet's page has the fleet's axes; those of its teams differ by less than a pixel.
    let page = team.to_page(centre);
    Some(Field {
        vehicle: team.name(own).to_string(),
        ne: offsets_m.iter().flat_map(|north_m| offsets_m.iter().map(|east_m| at(*north_m, *east_m))).collect(),
        north_m: offsets_m.iter().map(|offset_m| rounded(page.north_m() + offset_m)).collect(),
        east_m: offsets_m.iter().map(|offset_m| rounded(page.east_m() + offset_m)).collect(),
    })
}
