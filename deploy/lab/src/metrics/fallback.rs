//! Measures how much of its time a vehicle was flown by the fallback in the place of an external law.

use super::{VehicleNow, index};

/// The time of every vehicle, in observations.
#[derive(Debug)]
pub(super) struct Fallback {
    vehicles: Vec<Observed>,
}

/// Observations of one vehicle.
#[derive(Clone, Copy, Debug, Default)]
struct Observed {
    /// Of a live member that flies by an external law or by its fallback.
    all: u32,
    /// Of these, those in which the fallback flew.
    fallback: u32,
}

impl Observed {
    fn share(self) -> Option<f64> {
        (self.all > 0).then(|| f64::from(self.fallback) / f64::from(self.all))
    }
}

impl Fallback {
    pub(super) fn new(vehicles: usize) -> Self {
        Self { vehicles: vec![Observed::default(); vehicles] }
    }

    /// Observes all vehicles ten times a second.
    pub(super) fn observe(&mut self, vehicles: &[VehicleNow]) {
        for vehicle in vehicles.iter().filter(|vehicle| vehicle.is_live_member()) {
            let Some((fallback_flies, observed)) = vehicle.fallback_flies.zip(self.vehicles.get_mut(index(vehicle.id)))
            else {
                continue;
            };
            observed.all += 1;
            observed.fallback += u32::from(fallback_flies);
        }
    }

    /// The share of a vehicle, counted from 0; `None` if no external law was to fly it.
    pub(super) fn share(&self, nth: usize) -> Option<f64> {
        self.vehicles.get(nth).copied().and_then(Observed::share)
    }

    /// The largest share of a vehicle.
    pub(super) fn worst(&self) -> Option<f64> {
        self.vehicles.iter().copied().filter_map(Observed::share).reduce(f64::max)
    }
}

#[cfg(test)]
mod tests {
    use skein_common::id::VehicleId;
    use skein_common::state::Membership;
    use skein_core::plant::GroundTruth;

    use super::*;

    fn vehicle(id: u8, fallback_flies: Option<bool>) -> VehicleNow {
        let dead = VehicleNow::dead(VehicleId::new(id).unwrap(), GroundTruth::default());
        VehicleNow { runs: true, membership: Membership::Active, fallback_flies, ..dead }
    }

    #[test]
    fn the_share_is_that_of_the_vehicle_where_it_is_largest() {
        let mut measured = Fallback::new(3);
        assert_eq!(measured.worst(), None, "nothing was observed");
        for fallback_flies in [false, true, false, false] {
            measured.observe(&[vehicle(1, Some(false)), vehicle(2, Some(fallback_flies)), vehicle(3, None)]);
        }
        let away = VehicleNow { membership: Membership::Left, ..vehicle(2, Some(true)) };
        measured.observe(&[away]);
        assert_eq!([0, 1, 2].map(|nth| measured.share(nth)), [Some(0.0), Some(0.25), None]);
        assert_eq!(measured.worst(), Some(0.25));
    }
}
