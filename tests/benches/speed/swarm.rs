//! A swarm that flies as a world in virtual time does, built from the public parts of the core, so that the bench has
//! what goes in and out of each stage.

use skein_common::frame::Origin;
use skein_common::message::{self, Heartbeat, Message, State};
use skein_common::scenario::Scenario;
use skein_common::time::{LocalTime, Now};
use skein_core::builtin::BuiltInPlant;
use skein_core::formation::Workspace;
use skein_core::helicopter::{BuiltInVehicle, TICK_S};
use skein_core::peers::{Broadcast, PeerMessage, ReceivedState, SharedRecords};
use skein_core::plant::{Command, Controls, Measurement, PlantStatus};
use skein_core::start::starts;
use skein_core::station::{Clocks, Entering, Station};
use skein_host::blocks::Blocks;
use skein_lab::study::Study;
use skein_lab::world::World;

/// A message as an agent sends it.
pub(super) enum Sent {
    State(State),
    Heartbeat(Heartbeat),
}

impl Sent {
    /// What the other agents receive: encoded and decoded, its position in the swarm's frame.
    pub(super) fn through_wire(&self, origin: &Origin) -> PeerMessage {
        fn decoded<M: Message>(message: &M) -> M {
            message::decode(&message::encode(message)).expect("an agent's message decodes")
        }
        match self {
            Self::State(state) => PeerMessage::State(ReceivedState::new(decoded(state), origin)),
            Self::Heartbeat(heartbeat) => PeerMessage::Mission(decoded(heartbeat)),
        }
    }
}

/// One frame of every vehicle: what the stages received and what they gave.
pub(super) struct RecordedFrame {
    /// Time of the frame by the plants and by the agents.
    pub(super) now: Now,
    /// The measurement of each vehicle.
    pub(super) measurements: Vec<Measurement>,
    /// The command of each vehicle.
    pub(super) commands: Vec<Option<Command>>,
    /// The messages that all agents received.
    pub(super) received: Vec<PeerMessage>,
    /// The messages that the agents sent.
    pub(super) sent: Vec<Sent>,
}

/// The swarm.
pub(super) struct Swarm {
    pub(super) origin: Origin,
    stations: Vec<Station>,
    plants: Vec<BuiltInPlant>,
    blocks: Blocks,
    workspace: Workspace,
    in_flight: Vec<PeerMessage>,
    records: SharedRecords,
    ticks: u64,
}

impl Swarm {
    /// The swarm of this study on the ground.
    pub(super) fn new(study: &Study) -> Self {
        let (scenario, aircraft) = (&study.scenario, &study.aircraft[0]);
        let station = |id| {
            let parts = (aircraft, study.rules.clone());
            Station::new(scenario, id, skein_common::id::Incarnation(1), parts, Clocks::new(scenario, id))
        };
        Self {
            origin: Origin::new(scenario.origin.geodetic()),
            stations: scenario.ids().map(|id| station(id).expect("the hover flies")).collect(),
            plants: plants(study),
            blocks: Blocks::default(),
            workspace: Workspace::default(),
            in_flight: scenario.ids().map(PeerMessage::Appeared).collect(),
            records: SharedRecords::new(scenario),
            ticks: 0,
        }
    }

    /// Simulates one frame of every vehicle.
    pub(super) fn tick(&mut self) -> RecordedFrame {
        let received = std::mem::take(&mut self.in_flight);
        let local = LocalTime::from_nanoseconds(self.ticks * (TICK_S * 1e9) as u64);
        let (mut measurements, mut commands, mut sent) = (Vec::new(), Vec::new(), Vec::new());
        let mut plant = Default::default();
        self.records.update(local, &received);
        let broadcast = Broadcast { messages: &received, records: Some(&self.records), inbox: None };
        let nothing = PlantStatus::default();
        for (station, vehicle) in self.stations.iter_mut().zip(&self.plants) {
            let frame = vehicle.frame();
            let newest = (frame.time, Some(&frame.measurement));
            let entering = Entering { broadcast, ..Entering::of_plant(local, newest, &nothing) };
            let outputs = station.step(&entering, &mut self.workspace);
            plant = frame.time;
            measurements.push(frame.measurement);
            commands.push(outputs.command);
            sent.extend(outputs.outbox.state.map(|state| Sent::State(*state)));
            sent.extend(outputs.outbox.mission.map(|heartbeat| Sent::Heartbeat(*heartbeat)));
        }
        self.in_flight = sent.iter().map(|message| message.through_wire(&self.origin)).collect();
        self.blocks.advance(helicopters(&mut self.plants, &commands));
        self.ticks += 1;
        RecordedFrame { now: Now { plant, local }, measurements, commands, received, sent }
    }

    /// Checks that the vehicles are where those of a world are after as many ticks, to the bit: then the stages that are
    /// replayed from this swarm are those of a study.
    pub(super) fn check_against_world(&self, study: &Study) {
        let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).expect("the hover starts");
        (0..self.ticks).for_each(|_| world.tick());
        // A world keeps the ground truth of the beginning of its last frame.
        world.tick();
        let places: Vec<_> = self.plants.iter().map(|plant| plant.frame().truth).collect();
        let expected: Vec<_> = world.all_vehicles().map(|(_, _, truth, _)| *truth).collect();
        assert_eq!(places, expected, "the bench's swarm flies another flight than a world");
    }
}

/// The plants of a study at their starts.
pub(super) fn plants(study: &Study) -> Vec<BuiltInPlant> {
    let scenario: &Scenario = &study.scenario;
    let starts = starts(scenario).expect("the start area is large enough");
    let plant = |(id, start)| BuiltInPlant::new(scenario, id, &study.aircraft[0], start).expect("a flight model");
    scenario.ids().zip(&starts).map(plant).collect()
}

/// The helicopters among these plants, with their controls, as blocks take them.
pub(super) fn helicopters<'a>(
    plants: &'a mut [BuiltInPlant],
    commands: &'a [Option<Command>],
) -> impl Iterator<Item = (&'a mut BuiltInVehicle, Option<Controls>)> {
    plants.iter_mut().zip(commands).filter_map(|(plant, command)| match plant {
        BuiltInPlant::Helicopter(helicopter) => Some((&mut **helicopter, command.and_then(Command::controls))),
        BuiltInPlant::PointMass(_) => None,
    })
}
