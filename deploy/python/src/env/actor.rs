//! Acts on the vehicles of a world in place of their laws or of their own control.

use nalgebra::{Vector2, Vector3};
use skein_core::formation::external::{LawQuery, LawReply, ReplyCommand};
use skein_core::plant::Controls;
use skein_lab::study::{Pilot, Replaced};
use skein_lab::world::World;

/// The part of the control that an action replaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// Nothing: the scenario's own law flies.
    None,
    /// The law's answer: a velocity north, east, down, m/s.
    Velocity,
    /// The law's answer: a field north, east.
    Field,
    /// The helicopter's controls: roll, pitch, yaw, collective.
    Controls,
}

impl Action {
    pub(super) fn named(name: Option<&str>) -> Option<Self> {
        match name {
            None => Some(Self::None),
            Some("velocity") => Some(Self::Velocity),
            Some("field") => Some(Self::Field),
            Some("controls") => Some(Self::Controls),
            Some(_) => None,
        }
    }

    /// Numbers of an action.
    pub(super) fn size(self) -> usize {
        match self {
            Self::None => 0,
            Self::Velocity => 3,
            Self::Field => 2,
            Self::Controls => 4,
        }
    }

    /// The part of a flight that an action replaces.
    pub(super) fn replaces(self) -> Replaced {
        match self {
            Self::None => Replaced::Nothing,
            Self::Velocity | Self::Field => Replaced::Law,
            Self::Controls => Replaced::Controls,
        }
    }

    /// Whether an action answers the agents' queries.
    pub(super) fn answers(self) -> bool {
        matches!(self, Self::Velocity | Self::Field)
    }
}

/// Acts on one world.
#[derive(Debug)]
pub(super) struct Actor {
    action: Action,
    /// Numbers of every vehicle's action, in the order of ids.
    pub(super) actions: Vec<f64>,
    /// The newest query of every vehicle, and whether it waits for the next action.
    pub(super) queries: Vec<Option<(LawQuery, bool)>>,
    /// Ticks until the step is over.
    ticks_left: u64,
    /// Ticks that the scenario's own agents fly before the first observation, and those that they have flown.
    warm_up: u64,
    ticks: u64,
}

impl Actor {
    /// An actor for a world of this many vehicles, whose own agents fly so many ticks before the first observation.
    pub(super) fn new(action: Action, vehicles: usize, warm_up: u64) -> Self {
        let actions = vec![0.0; vehicles * action.size()];
        let queries = (0..vehicles).map(|_| None).collect();
        Self { action, actions, queries, ticks_left: 0, warm_up, ticks: 0 }
    }

    fn reply(&self, nth: usize, query: &LawQuery) -> LawReply {
        let size = self.action.size();
        let numbers = &self.actions[nth * size..][..size];
        let command = match *numbers {
            [north, east, down] => ReplyCommand::VelocityNed(Vector3::new(north, east, down)),
            _ => ReplyCommand::FieldNe(Vector2::new(numbers[0], numbers[1])),
        };
        let (vehicle, tick) = (query.vehicle, query.tick);
        LawReply { vehicle, tick, command, heading_rad: None, reached: None, log: Vec::new() }
    }
}

impl Pilot for Actor {
    fn begin(&mut self) {
        self.queries.iter_mut().for_each(|query| *query = None);
        (self.ticks_left, self.ticks) = (0, 0);
    }

    fn before(&mut self, world: &mut World, ticks: u64) {
        self.ticks_left = ticks;
        if self.action == Action::Controls {
            let ids: Vec<_> = world.all_vehicles().map(|(id, ..)| id).collect();
            for (id, numbers) in ids.into_iter().zip(self.actions.chunks_exact(4)) {
                let axis = |nth: usize| numbers[nth].clamp(-1.0, 1.0);
                let collective = numbers[3].clamp(0.0, 1.0);
                let controls = Controls { roll: axis(0), pitch: axis(1), yaw: axis(2), collective };
                world.set_controls(id, Some(controls));
            }
        }
        for nth in 0..self.queries.len() {
            if let Some((query, true)) = &self.queries[nth] {
                world.answer(self.reply(nth, query));
            }
            self.queries[nth].iter_mut().for_each(|(_, waits)| *waits = false);
        }
    }

    fn after_tick(&mut self, world: &mut World) {
        self.ticks += 1;
        self.ticks_left = self.ticks_left.saturating_sub(1);
        if !self.action.answers() {
            return;
        }
        for query in world.take_asks() {
            let nth = usize::from(query.vehicle.get()) - 1;
            // A vehicle whose period begins within a step flies the last action on.
            let waits = self.ticks_left == 0;
            if !waits {
                world.answer(self.reply(nth, &query));
            }
            if let Some(place) = self.queries.get_mut(nth) {
                *place = Some((query, waits));
            }
        }
    }

    fn is_ready(&self) -> bool {
        let asks = self.queries.iter().flatten().next().is_some();
        self.ticks >= self.warm_up && (asks || !self.action.answers())
    }
}
