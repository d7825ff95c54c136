//! Estimates whether a swarm fits onto this PC: how much processor time its agents need, from the measured cost of a
//! message and of a step.

mod measure;
mod message_cost;
mod relay;
mod wire;

use std::io::{self, BufRead, IsTerminal, Write};

use crate::os;
pub use measure::{Effort, Measured, StateRate, StepTime, measure};
pub use message_cost::{FRAME_HZ, MessageSize, MessageTime};
use skein_lab::error::Error;
pub use wire::{PaperEquation, data_output_bytes, of_datagram_bytes, of_segment_bytes};

/// Vehicles for each core below which a swarm fits onto any PC and nothing is measured.
const UNMEASURED_A_CORE: usize = 4;
/// Time for which the sessions are silent, and the equal time for which they send, s.
const SENDING_S: f64 = 0.6;
/// Number of attempts to measure the cost of a message: where other programs use the processor, silence can seem more
/// expensive than sending.
const TRIES: usize = 3;
/// Duration of each flight, s of virtual time.
const FLIGHT_S: f64 = 40.0;

/// Measured cost of an agent on this PC.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Costs {
    /// Processor time of a message from one agent to another, both ends together, µs.
    message_us: f64,
    /// Rate at which a vehicle sends its state, Hz.
    states_hz: f64,
    /// Processor time of its steps, flight model included.
    step: StepTime,
}

impl Costs {
    /// Measures for about two seconds; `None` where the system does not report processor time.
    ///
    /// # Errors
    /// If sessions cannot be opened, or no message arrives.
    fn measure() -> Result<Option<Self>, Error> {
        let failed = |why: String| Error::Failed(format!("capacity of this PC: {why}"));
        let message_us = (0..TRIES).find_map(|_| match message_cost::time(SENDING_S) {
            Ok(time) => time.message_us.map_or(Some(Ok(None)), |us| (us > 0.0).then_some(Ok(Some(us)))),
            Err(why) => Some(Err(why)),
        });
        let busy = || {
            Err("other programs use so much processor time that the cost of a message cannot be measured".to_owned())
        };
        let message_us = message_us.unwrap_or_else(busy).map_err(failed)?;
        let (state_rates, step) = measure::flights(FLIGHT_S).map_err(failed)?;
        let states_hz = state_rates.iter().map(|rate| rate.states_hz).fold(0.0, f64::max);
        let known = message_us.zip(step);
        Ok(known.map(|(message_us, step)| Self { message_us, states_hz, step }))
    }

    /// Number of cores that these agents need.
    fn cores(&self, Demand { agents, swarm, traces }: Demand) -> f64 {
        let (count, others) = (agents as f64, swarm as f64 - 1.0);
        let traces = if traces { count * FRAME_HZ } else { 0.0 };
        let messages = count * others * (self.states_hz + measure::HEARTBEAT_HZ) + traces;
        let steps_us = count * FRAME_HZ * (self.step.alone_us + self.step.per_peer_us * others);
        (messages * self.message_us + steps_us) * 1e-6
    }

    /// The largest number of agents that needs no more than `cores` cores.
    fn most(&self, demand: Demand, cores: f64) -> usize {
        let of = |agents: &usize| demand.of(*agents);
        (1..=usize::from(u8::MAX)).take_while(|agents| self.cores(of(agents)) <= cores).last().unwrap_or(0)
    }
}

/// Agents on one PC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Demand {
    /// Number of agents on this PC.
    pub agents: usize,
    /// Number of vehicles in their swarm, including those on other PCs.
    pub swarm: usize,
    /// Whether a program on this PC subscribes to their traces.
    pub traces: bool,
}

impl Demand {
    /// A whole swarm that `skein fly` flies and records on this PC.
    fn whole(vehicles: usize) -> Self {
        Self { agents: vehicles, swarm: vehicles, traces: true }
    }

    /// The same demand with another number of agents: of the same swarm, or of one that is entirely on this PC.
    fn of(self, agents: usize) -> Self {
        let swarm = if self.agents == self.swarm { agents } else { self.swarm };
        Self { agents, swarm, ..self }
    }

    /// Whether any PC with so many cores can run it, without a measurement.
    pub fn is_small(self, cores: usize) -> bool {
        let unmeasured = UNMEASURED_A_CORE * cores;
        self.agents * self.swarm.saturating_sub(1) <= unmeasured * (unmeasured - 1)
    }
}

/// Measures whether these agents fit onto this PC. Returns the reason with figures if they do not, `None` if they do.
///
/// # Errors
/// If the measurement fails.
pub fn exceeded_by(demand: Demand) -> Result<Option<String>, Error> {
    let cores = os::cores();
    if demand.is_small(cores) {
        return Ok(None);
    }
    Ok(Costs::measure()?.and_then(|costs| finding(&costs, demand, cores)))
}

/// Measures whether the agents of swarms of these sizes fit onto this PC. If they do not, asks the user at the terminal whether to fly
/// anyway; without a terminal, refuses.
///
/// # Errors
/// If they do not fit and the user does not confirm, or if the measurement fails.
pub fn ask_for(swarms: &[usize], anyway: bool) -> Result<(), Error> {
    let vehicles: usize = swarms.iter().sum();
    // A vehicle of a team receives what its team sends; of strangers it receives those that are near.
    let largest = swarms.iter().copied().max().unwrap_or(0);
    let (demand, cores) = (Demand { swarm: largest, ..Demand::whole(vehicles) }, os::cores());
    if anyway || demand.is_small(cores) {
        return Ok(());
    }
    eprintln!("measuring how many vehicles this PC can fly");
    let Some(costs) = Costs::measure()? else { return Ok(()) };
    check_demand(&costs, demand, cores, agrees)
}

/// The reason why these agents do not fit onto so many cores; `None` if they do.
fn finding(costs: &Costs, demand: Demand, cores: usize) -> Option<String> {
    let (needed, most) = (costs.cores(demand), costs.most(demand, cores as f64));
    (needed > cores as f64).then(|| {
        let agents =
            if demand.agents == 1 { "1 agent needs".to_owned() } else { format!("{} agents need", demand.agents) };
        format!(
            "{agents} {needed:.1} cores and this PC has {cores}: it can fly {most} (measured just now: {:.0} us of \
             processor time for a message, {:.0} messages a second from each agent to each other)",
            costs.message_us,
            costs.states_hz + measure::HEARTBEAT_HZ
        )
    })
}

fn check_demand(costs: &Costs, demand: Demand, cores: usize, ask: impl FnOnce(&str) -> bool) -> Result<(), Error> {
    let Some(finding) = finding(costs, demand, cores) else { return Ok(()) };
    let most = costs.most(demand, cores as f64);
    if ask(&finding) {
        return Ok(());
    }
    Err(Error::Refused(format!(
        "{finding}; fly at most {most} here (--set swarm.vehicles={most}), the whole swarm in virtual time (`skein study`) or on \
         several PCs (`skein cluster`), or --anyway"
    )))
}

/// Asks the user at the terminal whether to fly anyway; false without a terminal.
pub fn agrees(finding: &str) -> bool {
    if !io::stdin().is_terminal() || !io::stderr().is_terminal() {
        return false;
    }
    eprint!("{finding}. Fly anyway? [y/N] ");
    let _ = io::stderr().flush();
    let mut answer = String::new();
    io::stdin().lock().read_line(&mut answer).is_ok() && matches!(answer.trim(), "y" | "Y" | "yes")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Costs as measured on a PC with two cores.
    const COSTS: Costs =
        Costs { message_us: 100.0, states_hz: 5.0, step: StepTime { alone_us: 10.0, per_peer_us: 0.0 } };

    #[test]
    fn the_cost_grows_with_the_pairs() {
        // 64 × 63 × 10 messages and 64 × 50 traces of 100 us, 64 × 50 steps of 10 us.
        assert!((COSTS.cores(Demand::whole(64)) - (4.032 + 0.32 + 0.032)).abs() < 1e-9);
        let most = COSTS.most(Demand::whole(64), 2.0);
        assert!(COSTS.cores(Demand::whole(most)) <= 2.0 && COSTS.cores(Demand::whole(most + 1)) > 2.0, "{most}");
        assert_eq!(COSTS.most(Demand::whole(64), 0.0), 0);
    }

    #[test]
    fn a_host_is_charged_only_for_its_own_agents_of_a_larger_swarm() {
        let of_many = Demand { agents: 16, swarm: 128, traces: false };
        // 16 × 127 × 10 messages of 100 us, 16 × 50 steps of 10 us.
        assert!((COSTS.cores(of_many) - (2.032 + 0.008)).abs() < 1e-9);
        assert_eq!(COSTS.most(of_many, 2.0), 15);
        let message = finding(&COSTS, of_many, 2).unwrap();
        assert!(message.starts_with("16 agents need 2.0 cores and this PC has 2: it can fly 15 ("), "{message}");
        assert_eq!(finding(&COSTS, Demand { agents: 15, ..of_many }, 2), None);
        assert!(Demand { agents: 1, swarm: 13, traces: false }.is_small(1) && !of_many.is_small(2));
    }

    #[test]
    fn a_swarm_that_does_not_fit_is_refused_with_figures_unless_the_user_confirms() {
        assert!(check_demand(&COSTS, Demand::whole(32), 2, |_| panic!("asked")).is_ok());
        assert!(check_demand(&COSTS, Demand::whole(64), 2, |_| true).is_ok());
        let refused = check_demand(&COSTS, Demand::whole(64), 2, |_| false).unwrap_err();
        assert_eq!(refused.exit_code(), 2);
        let most = COSTS.most(Demand::whole(64), 2.0);
        let message = refused.to_string();
        assert!(
            message.starts_with(&format!("64 agents need 4.4 cores and this PC has 2: it can fly {most} (")),
            "{message}"
        );
        assert!(
            message.contains(&format!("--set swarm.vehicles={most}")) && message.ends_with("--anyway"),
            "{message}"
        );
    }

    #[test]
    #[ignore = "needs a quiet PC: the step quiet of .ci/long"]
    fn the_cost_of_an_agent_is_measured() {
        let Some(costs) = Costs::measure().unwrap() else { return };
        assert!(costs.message_us > 0.0 && costs.message_us < 20_000.0, "{costs:?}");
        assert!(costs.states_hz >= 4.0 && costs.step.alone_us > 0.1, "{costs:?}");
        assert!(ask_for(&[1], false).is_ok());
    }
}
