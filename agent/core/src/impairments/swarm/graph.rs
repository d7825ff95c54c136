//! The senders whose states each vehicle of a swarm receives, by `network.graph`.

use alloc::vec;
use alloc::vec::Vec;

use skein_common::frame::PositionNed;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::{Graph, Scenario};
use skein_common::time::LocalTime;

use super::sender::SwarmSender;

/// Whose states every vehicle receives.
#[derive(Clone, Debug)]
pub(super) enum SwarmGraph {
    All,
    /// The receivers of each sender, by id.
    Edges(Vec<VehicleSet>),
    Nearest(Nearest),
}

/// The nearest senders of every vehicle.
#[derive(Clone, Debug)]
pub(super) struct Nearest {
    count: usize,
    /// Age beyond which a sender is not selected, s.
    stale_s: f64,
    /// By receiver.
    of: Vec<NearestSenders>,
    /// A length that no sender's reported position has exceeded on its way, m: the sum over the updates of the longest way in each.
    travelled_m: f64,
    reported: Vec<Option<PositionNed>>,
    /// Number of changes of what receivers know of any sender's place otherwise than by its way.
    placements: u64,
    /// Buffer for sorting.
    distances: Vec<(f64, VehicleId)>,
}

/// The nearest senders of one vehicle.
#[derive(Clone, Debug, Default)]
struct NearestSenders {
    /// `None` while no position is known.
    selected: Option<VehicleSet>,
    /// Those that can be the nearest, if they are known.
    candidates: Option<Candidates>,
}

/// The senders that can be among the nearest until the receiver and any sender have moved towards each other by the skin, as in a
/// list of L. Verlet (1967).
#[derive(Clone, Debug)]
struct Candidates {
    senders: Vec<VehicleId>,
    /// [`Nearest::placements`] then.
    placements: u64,
    /// Position of the receiver, and [`Nearest::travelled_m`] then.
    own: PositionNed,
    travelled_m: f64,
    /// Distance within which there were enough senders, m; infinite if there were too few.
    within_m: f64,
    skin_m: f64,
}

impl SwarmGraph {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let count = scenario.ids().count();
        match scenario.network.graph {
            Graph::All => Self::All,
            Graph::Edges => {
                let of = |from| {
                    let edges = scenario.network.edges.iter().filter(move |[sender, _]| *sender == from);
                    edges.map(|[_, receiver]| *receiver).collect()
                };
                Self::Edges(scenario.ids().map(of).collect())
            }
            Graph::Nearest => Self::Nearest(Nearest {
                count: scenario.network.neighbours,
                stale_s: scenario.network.peer_stale_s,
                of: vec![NearestSenders::default(); count],
                travelled_m: 0.0,
                reported: vec![None; count],
                placements: 0,
                distances: Vec::new(),
            }),
        }
    }

    /// Forgets the selection of a vehicle whose agent has ended.
    pub(super) fn forget(&mut self, receiver: VehicleId) {
        if let Self::Nearest(Nearest { of, .. }) = self {
            of[usize::from(receiver.get()) - 1] = NearestSenders::default();
        }
    }

    /// Those of these receivers that receive states of this sender.
    pub(super) fn receivers(&self, from: VehicleId, receivers: VehicleSet) -> VehicleSet {
        match self {
            Self::All => receivers,
            Self::Edges(of) => receivers.both(of[usize::from(from.get()) - 1]),
            Self::Nearest(Nearest { of, .. }) => {
                let includes = |id: &VehicleId| {
                    of[usize::from(id.get()) - 1].selected.is_none_or(|selected| selected.contains(from))
                };
                receivers.iter().filter(includes).collect()
            }
        }
    }

    /// Notes that receivers know of a sender's place otherwise than by its way ([`SwarmSender::report_place`]).
    pub(super) fn placed_changed(&mut self) {
        if let Self::Nearest(Nearest { placements, .. }) = self {
            *placements += 1;
        }
    }

    /// Selects the nearest senders by the positions of the receivers and by those that the senders have reported.
    pub(super) fn update(
        &mut self,
        now: LocalTime,
        positions: impl Iterator<Item = Option<PositionNed>>,
        senders: &[SwarmSender],
    ) {
        let Self::Nearest(nearest) = self else { return };
        nearest.note_ways(senders);
        let Nearest { count, stale_s, of, travelled_m, placements, distances, .. } = nearest;
        for ((own, id), NearestSenders { selected, candidates }) in
            positions.zip(VehicleId::first(senders.len())).zip(of)
        {
            let Some(own) = own else { continue };
            let place =
                |from: VehicleId| senders.get(usize::from(from.get()) - 1)?.place_known_to(id).filter(|_| from != id);
            let distance = |from| place(from).map(|(position, _)| ((position - own).norm_squared(), from));
            let is_young = |from| place(from).is_some_and(|(_, sent_at)| now.seconds_since(sent_at) <= *stale_s);
            if let Some(known) = candidates {
                distances.clear();
                distances.extend(known.senders.iter().copied().filter(|from| is_young(*from)).filter_map(distance));
                let complete_m = known.complete_within_m(own, *travelled_m);
                let within = distances.iter().filter(|(squared, _)| *squared <= complete_m * complete_m).count();
                let is_right = complete_m == f64::INFINITY || (complete_m > 0.0 && within >= *count);
                if is_right && known.placements == *placements {
                    *selected = first(distances, *count);
                    continue;
                }
            }
            distances.clear();
            distances.extend(VehicleId::first(senders.len()).filter(|from| is_young(*from)).filter_map(distance));
            *selected = first(distances, *count);
            let within_m = if distances.len() >= *count {
                distances.iter().take(*count).map(|(squared, _)| *squared).fold(0.0, f64::max).sqrt()
            } else {
                f64::INFINITY
            };
            let skin_m = SKIN_M + SKIN_SHARE * within_m;
            let listed_m = within_m + 2.0 * skin_m;
            // A sender whose position is old may report a new one.
            let all = VehicleId::first(senders.len()).filter_map(distance);
            let listed = all.filter(|(squared, _)| *squared <= listed_m * listed_m).map(|(_, from)| from).collect();
            let (travelled_m, placements) = (*travelled_m, *placements);
            *candidates = Some(Candidates { senders: listed, placements, own, travelled_m, within_m, skin_m });
        }
    }
}

/// Width of the skin, m, and as a share of the distance of the farthest selected sender.
const SKIN_M: f64 = 2.0;
const SKIN_SHARE: f64 = 0.1;

impl Nearest {
    /// Adds up the ways of the senders' reported positions.
    fn note_ways(&mut self, senders: &[SwarmSender]) {
        let mut longest_m = 0.0_f64;
        for (reported, sender) in self.reported.iter_mut().zip(senders) {
            let Some((position, _)) = sender.place else { continue };
            if let Some(before) = reported.replace(position) {
                longest_m = longest_m.max((position - before).norm());
            }
        }
        self.travelled_m += longest_m;
    }
}

impl Candidates {
    /// Distance within which every sender is a candidate now, m.
    fn complete_within_m(&self, own: PositionNed, travelled_m: f64) -> f64 {
        let moved_m = (own - self.own).norm() + travelled_m - self.travelled_m;
        self.within_m + 2.0 * self.skin_m - moved_m - 1e-6
    }
}

/// The first of these by distance and id; `None` if there are none. They are in front afterwards.
fn first(distances: &mut [(f64, VehicleId)], count: usize) -> Option<VehicleSet> {
    let order = |one: &(f64, VehicleId), other: &(f64, VehicleId)| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1));
    if count > 0 && distances.len() > count {
        distances.select_nth_unstable_by(count - 1, order);
    }
    (!distances.is_empty()).then(|| distances.iter().take(count).map(|(_, id)| *id).collect())
}
