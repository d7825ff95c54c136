//! The network that carries states and intents of other teams to the vehicles of one team.
//!
//! One channel to each vehicle, with the settings of `[network]`, carries all of them: their loss, delay, jitter, reordering,
//! copies and range. Settings for single links, the graph and cuts are about the own team. The fate of a message is drawn for all
//! its receivers together: an agent beside a vehicle is the only one, a study has the whole team.

use alloc::collections::VecDeque;
use alloc::vec;
use alloc::vec::Vec;

use nalgebra::Vector2;
use skein_common::frame::PositionNed;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::{Quality, Scenario};
use skein_common::time::LocalTime;

use super::Delivery;
use super::channel::{Channel, delivery};
use super::channels::{Range, only_delays};
use super::draw::{Draws, MessageKey, STRANGERS};
use super::numbers::{self, Numbers};
use crate::intent::ReceivedIntent;
use crate::strangers::{ArrivalAt, StrangerRecords, StrangerState};

/// The network from other teams to the vehicles of one team.
///
/// Most strangers are so far away that they are no obstacle for any vehicle: their states need no fate, and they are not kept.
#[derive(Clone, Debug)]
pub struct StrangerNetwork {
    /// The settings of the channels, which have no bandwidth: the strangers share no link.
    quality: Quality,
    range: Option<Range>,
    /// Random impairments; `None` if there is only the delay.
    random: Option<RandomFates>,
    /// The vehicles with an agent, and the positions of those that know theirs, by id.
    present: VehicleSet,
    places: Vec<Option<PositionNed>>,
    vicinity: Option<Vicinity>,
    records: StrangerRecords,
    /// Intents in flight with their receivers, the earliest arrival first, and those that have arrived since the last step.
    in_flight: VecDeque<(ReceivedIntent, VehicleSet)>,
    arrived: Vec<(ReceivedIntent, VehicleSet)>,
    /// Buffer for the arrivals of one message.
    arrivals: Vec<ArrivalAt>,
}

#[derive(Clone, Debug)]
struct RandomFates {
    draws: Draws,
    numbers: Numbers,
    /// The channel to each vehicle, by id; empty if a channel has nothing to remember.
    channels: Vec<Channel>,
}

/// The part of the air in which strangers matter to the team.
#[derive(Clone, Copy, Debug)]
struct Vicinity {
    /// Corners of the rectangle that holds all receivers, in the south-west and in the north-east, north and east, m.
    south_west_m: Vector2<f64>,
    north_east_m: Vector2<f64>,
    /// The longest reach of a receiver, m.
    reach_m: f64,
}

impl Vicinity {
    /// Whether this stranger may come within reach of a receiver by this state, which arrives up to `late_s` from now.
    fn holds(&self, state: &StrangerState, late_s: f64) -> bool {
        let place = state.position.horizontal();
        let outside_m = (self.south_west_m - place).sup(&(place - self.north_east_m)).sup(&Vector2::zeros());
        outside_m.norm() <= state.matters_within_m(self.reach_m, late_s)
    }
}

impl StrangerNetwork {
    /// The network at the start, without a receiver.
    pub fn new(scenario: &Scenario) -> Self {
        let quality = Quality { bandwidth_bit_s: None, ..scenario.network.quality() };
        let range = Range::of(&scenario.network);
        let count = usize::from(scenario.roster());
        let random = || {
            let draws = Draws::new(scenario.seed);
            let numbers = Numbers::new(draws.clone(), numbers::needed(|has| has(&quality)), count);
            let channels = quality.burst_s.map_or(Vec::new(), |_| vec![Channel::default(); count + 1]);
            RandomFates { draws, numbers, channels }
        };
        Self {
            quality,
            range,
            random: (!only_delays(&quality) || range.is_some()).then(random),
            present: VehicleSet::default(),
            places: vec![None; count + 1],
            vicinity: None,
            records: StrangerRecords::default(),
            in_flight: VecDeque::new(),
            arrived: Vec::new(),
            arrivals: Vec::new(),
        }
    }

    /// Begins the agent of a vehicle: nothing is known to it, nor on its way.
    pub fn begin(&mut self, vehicle: VehicleId) {
        self.end(vehicle);
        self.present.insert(vehicle);
    }

    /// Ends the agent of a vehicle.
    pub fn end(&mut self, vehicle: VehicleId) {
        self.present.remove(vehicle);
        self.records.forget(vehicle);
        self.in_flight.iter_mut().for_each(|(_, receivers)| receivers.remove(vehicle));
        self.arrived.iter_mut().for_each(|(_, receivers)| receivers.remove(vehicle));
        let channels = self.random.iter_mut().flat_map(|random| random.channels.get_mut(usize::from(vehicle.get())));
        channels.for_each(|channel| *channel = Channel::default());
    }

    /// Takes the positions of all vehicles with an agent, if they know them, and the distances from which a stranger matters to
    /// them, m. They count for the states that are sent from now on.
    pub fn set_receivers(&mut self, receivers: impl Iterator<Item = (VehicleId, Option<PositionNed>, f64)>) {
        self.places.fill(None);
        let bounds = receivers.map(|(id, position, reach_m)| {
            self.places.get_mut(usize::from(id.get())).into_iter().for_each(|place| *place = position);
            position.map(|position| (position.horizontal(), position.horizontal(), reach_m))
        });
        let around = bounds.reduce(|one, other| {
            let ((south_west, north_east, reach_m), (other_sw, other_ne, other_m)) = one.zip(other)?;
            Some((south_west.inf(&other_sw), north_east.sup(&other_ne), reach_m.max(other_m)))
        });
        let vicinity = |(south_west_m, north_east_m, reach_m)| Vicinity { south_west_m, north_east_m, reach_m };
        self.vicinity = around.flatten().map(vicinity);
    }

    /// Sends a state that an ideal network delivers at `state.at` to these vehicles, and that is handed over now: it arrives at
    /// the earliest now.
    pub fn send(&mut self, state: &StrangerState, now: LocalTime, receivers: VehicleSet) {
        let Quality { delay_s, jitter_s, reorder_s, .. } = self.quality;
        // A copy is late by a second random delay.
        let late_s = delay_s + 2.0 * jitter_s + reorder_s;
        let matters = self.vicinity.is_none_or(|vicinity| vicinity.holds(state, late_s));
        if !matters && !self.records.has(state.id) {
            return;
        }
        let key = MessageKey::of_state(state.id, state.order);
        self.draw_arrivals(&key, (state.at, now), receivers, Some(state.position));
        self.records.add(state, now, &self.arrivals, matters);
    }

    /// Sends an intent that an ideal network delivers at `intent.at`, as [`Self::send`] sends a state. An intent has no
    /// position of its sender, so range does not apply.
    pub fn send_intent(&mut self, intent: &ReceivedIntent, now: LocalTime, receivers: VehicleSet) {
        let key = MessageKey::of_intent(intent.id, intent.order);
        self.draw_arrivals(&key, (intent.at, now), receivers, None);
        for &ArrivalAt { at, receivers } in &self.arrivals {
            let place = self.in_flight.partition_point(|(earlier, _)| earlier.at <= at);
            self.in_flight.insert(place, (ReceivedIntent { at, ..*intent }, receivers));
        }
    }

    /// Delivers what arrives by now. Intents that arrived earlier are not there any more: call it once before each step.
    pub fn deliver(&mut self, now: LocalTime) {
        self.arrived.clear();
        while let Some(intent) = self.in_flight.pop_front_if(|(intent, _)| intent.at <= now) {
            self.arrived.push(intent);
        }
        self.records.forget_silent(now);
    }

    /// The states of strangers that the vehicles have received.
    pub fn records(&self) -> &StrangerRecords {
        &self.records
    }

    /// The intents that have arrived at a vehicle since the last step, in the order of their arrival, with the correct time of it.
    pub fn intents(&self, receiver: VehicleId) -> impl Iterator<Item = &ReceivedIntent> {
        let its = self.arrived.iter().filter(move |(_, receivers)| receivers.contains(receiver));
        its.map(|(intent, _)| intent)
    }

    /// Draws the arrivals of a message and of its copies: an ideal network delivers it at `at`, it is handed over `now`, and it
    /// comes `from` this position, if the range applies to it.
    fn draw_arrivals(
        &mut self,
        key: &MessageKey,
        (at, now): (LocalTime, LocalTime),
        receivers: VehicleSet,
        from: Option<PositionNed>,
    ) {
        let Self { quality, range, random, present, places, arrivals, .. } = self;
        let receivers = receivers.both(*present);
        arrivals.clear();
        if receivers.is_empty() {
            return;
        }
        let Some(RandomFates { draws, numbers, channels }) = random else {
            arrivals.push(ArrivalAt { at: at.plus_seconds(quality.delay_s).max(now), receivers });
            return;
        };
        numbers.draw(key, range.is_some());
        for id in receivers.iter() {
            let place = || places.get(usize::from(id.get())).copied().flatten();
            let ends = range.as_ref().and_then(|range| Some((range, from?, place()?)));
            let lost_by_distance = ends.map_or(0.0, |(range, from, place)| range.loss_at((place - from).norm()));
            let channel = channels.get_mut(usize::from(id.get()));
            let is_in_burst =
                channel.and_then(|channel| channel.is_in_burst(quality, at, |nth| draws.of_link(STRANGERS, nth, id)));
            let fate = delivery(quality, |what| numbers.of(what, id), at, is_in_burst, lost_by_distance);
            let Delivery::Arrives { at, copy_at } = fate else { continue };
            for at in [Some(at), copy_at].into_iter().flatten() {
                let at = at.max(now);
                match arrivals.iter_mut().find(|arrival| arrival.at == at) {
                    Some(arrival) => arrival.receivers.insert(id),
                    None => arrivals.push(ArrivalAt { at, receivers: [id].into_iter().collect() }),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use alloc::string::String;

    use proptest::prelude::*;
    use skein_common::frame::VelocityNed;
    use skein_common::id::{FleetVehicle, Incarnation};
    use skein_common::message::MessageOrder;
    use skein_common::scenario::{Source, load};

    use super::super::channel::Direction;
    use super::*;
    use crate::intent::{Area, Intent};
    use crate::skew::StepClock;
    use crate::strangers::{KnownStrangers, Strangers};

    fn scenario(vehicles: usize, keys: &str) -> Scenario {
        let text = alloc::format!("swarm.vehicles = {vehicles}\n{keys}");
        load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario
    }

    fn state(team: u16, sequence: u64, north_m: f64, at_s: f64) -> StrangerState {
        StrangerState {
            id: alloc::format!("{team}/1").parse().unwrap(),
            order: MessageOrder { incarnation: Incarnation(1), sequence },
            position: PositionNed::new(north_m, 0.0, -30.0),
            velocity: VelocityNed::new(0.0, 0.0, 0.0),
            at: LocalTime::from_seconds(at_s),
        }
    }

    /// Shares of a thousand states, each of another vehicle, that have arrived after 0.25 s and after 2 s, from this distance.
    fn received(keys: &str, distance_m: f64) -> (f64, f64) {
        let own = VehicleId::new(1).unwrap();
        let mut network = StrangerNetwork::new(&scenario(1, keys));
        network.begin(own);
        network.set_receivers([(own, Some(PositionNed::new(0.0, 0.0, -30.0)), 100.0)].into_iter());
        let states = (2..1002).map(|team| state(team, 1, distance_m, 1.0));
        for state in states.clone() {
            network.send(&state, state.at, [own].into_iter().collect());
        }
        let share_at = |now_s: f64| {
            let now = LocalTime::from_seconds(now_s);
            let newest = |state: &StrangerState| network.records().newest(state.id, own, now);
            states.clone().filter(|state| newest(state).is_some_and(|state| state.at <= now)).count() as f64 / 1000.0
        };
        (share_at(1.25), share_at(3.0))
    }

    #[test]
    fn states_of_strangers_are_lost_delayed_and_out_of_range_as_the_network_says() {
        assert_eq!(received("", 100.0), (1.0, 1.0));
        assert_eq!(received("network.delay_s = 0.3", 100.0), (0.0, 1.0));
        let (soon, late) = received("network.loss = 0.2\nnetwork.delay_s = 0.2", 100.0);
        assert!(soon == late && (0.75..0.85).contains(&late), "{late}");
        let (soon, late) = received("network.jitter_s = 0.5", 100.0);
        assert!((0.4..0.6).contains(&soon) && late == 1.0, "{soon} {late}");
        assert_eq!(received("network.range_m = 90", 100.0).1, 0.0);
    }

    /// The same network, evaluated plainly: one receiver, one message at a time, all arrivals in a list.
    struct Plain<'a> {
        network: &'a StrangerNetwork,
        draws: Draws,
        receiver: VehicleId,
        channel: Channel,
        runs: bool,
        states: Vec<StrangerState>,
        intents: Vec<ReceivedIntent>,
    }

    impl Plain<'_> {
        fn arrivals(
            &mut self,
            key: &MessageKey,
            at: LocalTime,
            distance_m: Option<f64>,
            now: LocalTime,
        ) -> Vec<LocalTime> {
            if !self.runs {
                return Vec::new();
            }
            let lost = self.network.range.zip(distance_m).map_or(0.0, |(range, distance_m)| range.loss_at(distance_m));
            let direction = Direction { sender: STRANGERS, receiver: self.receiver, quality: &self.network.quality };
            let fate = self.channel.fate(&self.draws, &direction, (key, || 0), at, lost);
            let Delivery::Arrives { at, copy_at } = fate else { return Vec::new() };
            let mut arrivals = vec![at.max(now)];
            // A copy that arrives together with the message says nothing.
            arrivals.extend(copy_at.map(|at| at.max(now)).filter(|copy_at| *copy_at != arrivals[0]));
            arrivals
        }

        fn send(&mut self, state: &StrangerState, place: Option<PositionNed>, now: LocalTime) {
            let distance_m = place.map(|place| (place - state.position).norm());
            let arrivals = self.arrivals(&MessageKey::of_state(state.id, state.order), state.at, distance_m, now);
            self.states.extend(arrivals.into_iter().map(|at| StrangerState { at, ..*state }));
        }

        fn send_intent(&mut self, intent: &ReceivedIntent, now: LocalTime) {
            let arrivals = self.arrivals(&MessageKey::of_intent(intent.id, intent.order), intent.at, None, now);
            self.intents.extend(arrivals.into_iter().map(|at| ReceivedIntent { at, ..*intent }));
        }

        fn newest(&self, id: FleetVehicle, now: LocalTime) -> Option<StrangerState> {
            let arrived = self.states.iter().filter(|state| state.id == id && state.at <= now);
            arrived.copied().max_by_key(|state| (state.order, core::cmp::Reverse(state.at)))
        }

        fn end(&mut self) {
            self.runs = false;
            self.channel = Channel::default();
            self.states.clear();
            self.intents.clear();
        }
    }

    #[derive(Clone, Copy, Debug)]
    enum Event {
        /// A vehicle of this team sends a state or an intent to these vehicles.
        State(u16, u8),
        Intent(u16, u8),
        /// The agent of this vehicle ends or begins.
        Change(u8),
    }

    fn event() -> impl Strategy<Value = Event> {
        prop_oneof![
            8 => (2_u16..6, any::<u8>()).prop_map(|(team, receivers)| Event::State(team, receivers)),
            3 => (2_u16..6, any::<u8>()).prop_map(|(team, receivers)| Event::Intent(team, receivers)),
            1 => (0_u8..6).prop_map(Event::Change),
        ]
    }

    fn share() -> impl Strategy<Value = f64> {
        prop_oneof![Just(0.0), 0.05..0.9_f64]
    }

    /// The keys of a network that loses this share of all messages.
    fn keys(loss: impl Strategy<Value = f64>) -> impl Strategy<Value = String> {
        let time_s = || prop_oneof![Just(0.0), 0.01..1.0_f64];
        let bursts = prop_oneof![Just(""), Just("network.burst_s = 0.3\n")];
        let range = prop_oneof![Just(""), Just("network.range_m = 200\nnetwork.fade_m = 50\n")];
        (0..10_000_u64, (loss, share(), share()), (time_s(), time_s(), 0.01..1.0_f64), bursts, range).prop_map(
            |(seed, (loss, reorder, duplicate), (delay_s, jitter_s, reorder_s), bursts, range)| {
                alloc::format!(
                    "seed = {seed}\nnetwork.loss = {loss}\nnetwork.reorder = {reorder}\nnetwork.reorder_s = {reorder_s}\n\
                     network.duplicate = {duplicate}\nnetwork.delay_s = {delay_s}\nnetwork.jitter_s = {jitter_s}\n{bursts}{range}"
                )
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn a_team_receives_what_each_vehicle_by_itself_would_receive(
            keys in keys(share()), events in proptest::collection::vec((event(), 0..4_u64), 1..120),
        ) {
            let scenario = scenario(6, &keys);
            let empty = StrangerNetwork::new(&scenario);
            let mut network = empty.clone();
            let mut plain: Vec<Plain<'_>> = VehicleId::first(6).map(|receiver| Plain {
                network: &empty,
                draws: Draws::new(scenario.seed),
                receiver,
                channel: Channel::default(),
                runs: true,
                states: Vec::new(),
                intents: Vec::new(),
            }).collect();
            VehicleId::first(6).for_each(|id| network.begin(id));
            let place = |id: VehicleId| (id.get() != 3).then(|| PositionNed::new(40.0 * f64::from(id.get()), 0.0, -30.0));
            let (mut frame, mut before) = (0, LocalTime::ZERO);
            for (sequence, (event, frames)) in (1..).zip(events) {
                for _ in 0..frames {
                    frame += 1;
                    let now = LocalTime::from_seconds(0.02 * frame as f64);
                    network.deliver(now);
                    for plain in &mut plain {
                        let mut arrived: Vec<_> = plain.intents.extract_if(.., |intent| intent.at <= now).collect();
                        arrived.sort_by_key(|intent| intent.at);
                        prop_assert_eq!(network.intents(plain.receiver).copied().collect::<Vec<_>>(), arrived);
                        for team in 2..6 {
                            let id = state(team, 0, 0.0, 0.0).id;
                            let newest = network.records().newest(id, plain.receiver, now);
                            prop_assert_eq!(newest, plain.newest(id, now));
                        }
                    }
                    before = now;
                }
                // A message is handed over up to 0.16 s after an ideal network would deliver it.
                let at = LocalTime::from_seconds((before.seconds() - 0.02 * (sequence % 9) as f64).max(0.0));
                let chosen = |bits: u8| VehicleId::first(6).filter(move |id| bits >> (id.get() - 1) & 1 == 1);
                match event {
                    Event::State(team, receivers) => {
                        let sent = StrangerState { at, ..state(team, sequence, 30.0 * f64::from(team), 0.0) };
                        network.set_receivers(VehicleId::first(6).map(|id| (id, place(id), 100.0)));
                        network.send(&sent, before, chosen(receivers).collect());
                        for id in chosen(receivers) {
                            plain[usize::from(id.get()) - 1].send(&sent, place(id), before);
                        }
                    }
                    Event::Intent(team, receivers) => {
                        let state = state(team, sequence, 0.0, 0.0);
                        let occupied = Area { centre: state.position, radius_m: 50.0 };
                        let intent = Intent { occupied, wanted: None };
                        let sent = ReceivedIntent { id: state.id, order: state.order, intent, at };
                        network.send_intent(&sent, before, chosen(receivers).collect());
                        chosen(receivers).for_each(|id| plain[usize::from(id.get()) - 1].send_intent(&sent, before));
                    }
                    Event::Change(nth) => {
                        let vehicle = &mut plain[usize::from(nth)];
                        match vehicle.runs {
                            true => network.end(vehicle.receiver),
                            false => network.begin(vehicle.receiver),
                        }
                        let runs = !vehicle.runs;
                        vehicle.end();
                        vehicle.runs = runs;
                    }
                }
            }
        }
    }

    /// Time between two states of a vehicle, s, and the longest flight of the test, in such times.
    const EVERY_S: f64 = 0.2;
    const FLIGHT: usize = 200;

    /// A flight from a place, north and east, m, by these velocities, m/s, each for 5 s.
    fn flight() -> impl Strategy<Value = ([f64; 2], Vec<[f64; 2]>)> {
        let speed = -13.0..13.0_f64;
        let velocity = [speed.clone(), speed];
        ([-600.0..600.0_f64, -600.0..600.0_f64], proptest::collection::vec(velocity, 9))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn whoever_is_too_far_away_to_be_kept_is_no_obstacle(
            // Where most messages are lost, old states count for long.
            keys in keys(0.7..0.97_f64), flights in proptest::collection::vec(flight(), 8), reach_m in 20.0..200.0_f64,
        ) {
            let scenario = scenario(3, &keys);
            let all = StrangerNetwork::new(&scenario);
            let mut networks = [all.clone(), all];
            networks.iter_mut().for_each(|network| VehicleId::first(3).for_each(|id| network.begin(id)));
            let mut stages: Vec<[Strangers; 2]> =
                VehicleId::first(3).map(|id| [Strangers::new(id), Strangers::new(id)]).collect();
            let mut flying: Vec<(PositionNed, VelocityNed)> =
                flights.iter().map(|([north_m, east_m], _)| (PositionNed::new(*north_m, *east_m, -30.0), VelocityNed::default())).collect();
            let mut kept = 0;
            for nth in 0..FLIGHT {
                let now = LocalTime::from_seconds(EVERY_S * nth as f64);
                for ((place, velocity), (_, by)) in flying.iter_mut().zip(&flights) {
                    let [north_m_s, east_m_s] = by[nth / 25];
                    *velocity = VelocityNed::new(north_m_s, east_m_s, 0.0);
                    *place = *place + velocity.0 * EVERY_S;
                }
                let own = |id: VehicleId| flying[usize::from(id.get()) - 1].0;
                // The second network keeps all.
                for (network, reach_m) in networks.iter_mut().zip([reach_m, 1e9]) {
                    network.set_receivers(VehicleId::first(3).map(|id| (id, Some(own(id)), reach_m)));
                }
                for (team, (position, velocity)) in (2..).zip(&flying[3..]) {
                    let sent = StrangerState { position: *position, velocity: *velocity, at: now, ..state(team, nth as u64, 0.0, 0.0) };
                    networks.iter_mut().for_each(|network| network.send(&sent, now, VehicleId::first(3).collect()));
                }
                networks.iter_mut().for_each(|network| network.deliver(now));
                kept += usize::from(networks[0].records.len() < networks[1].records.len());
                for (id, stages) in VehicleId::first(3).zip(&mut stages) {
                    let [found, of_all] = core::array::from_fn(|nth| {
                        let (records, clock) = (networks[nth].records(), StepClock::default());
                        let known = KnownStrangers { records, right: now, clock };
                        stages[nth].near(now, Some(known), (own(id), reach_m)).collect::<Vec<_>>()
                    });
                    prop_assert_eq!(found, of_all);
                }
            }
            prop_assume!(kept > 0);
        }
    }
}
