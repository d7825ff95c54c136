//! Whether a swarm fits onto this PC: what its agents will ask of the processor, from what a message and a step cost here.

use std::io::{self, BufRead, IsTerminal, Write};

use super::measure::{self, StepTime};
use super::message_cost::{self, FRAME_HZ};
use crate::os;
use skein_lab::error::Error;

/// Smaller swarms fit onto any PC: so many vehicles a core are not measured.
const UNMEASURED_A_CORE: usize = 4;
/// How long sessions are silent, and how long they talk, s.
const SENDING_S: f64 = 0.6;
/// So often is measured what a message costs: where other programs use the processor, silence can seem dearer than talk.
const TRIES: usize = 3;
/// Each flight's length in virtual time, s.
const FLIGHT_S: f64 = 40.0;

/// What an agent costs here, measured.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Costs {
    /// A message from one agent's hands into another's, both ends together, µs of processor.
    message_us: f64,
    /// How often a vehicle sends its state, Hz.
    states_hz: f64,
    /// How often it sends its register, Hz.
    heartbeat_hz: f64,
    /// Its steps, flight model included.
    step: StepTime,
}

impl Costs {
    /// Measures for some two seconds; `None` where the system does not tell processor time.
    ///
    /// # Errors
    /// If sessions cannot be opened, or nothing comes through.
    fn measure() -> Result<Option<Self>, Error> {
        let failed = |why: String| Error::Failed(format!("what this PC carries: {why}"));
        let message_us = (0..TRIES).find_map(|_| match message_cost::time(SENDING_S) {
            Ok(time) => time.message_us.map_or(Some(Ok(None)), |us| (us > 0.0).then_some(Ok(Some(us)))),
            Err(why) => Some(Err(why)),
        });
        let busy = || Err("other programs use so much of it that the cost of a message cannot be measured".to_owned());
        let message_us = message_us.unwrap_or_else(busy).map_err(failed)?;
        let (talk, step) = measure::flights(FLIGHT_S).map_err(failed)?;
        let states_hz = talk.iter().map(|talk| talk.states_hz).fold(0.0, f64::max);
        let known = message_us.zip(step);
        Ok(known.map(|(message_us, step)| Self { message_us, states_hz, heartbeat_hz: measure::HEARTBEAT_HZ, step }))
    }

    /// Cores that these agents ask for.
    fn cores(&self, Demand { agents, swarm, traces }: Demand) -> f64 {
        let (count, others) = (agents as f64, swarm as f64 - 1.0);
        let traces = if traces { count * FRAME_HZ } else { 0.0 };
        let messages = count * others * (self.states_hz + self.heartbeat_hz) + traces;
        let steps_us = count * FRAME_HZ * (self.step.alone_us + self.step.per_peer_us * others);
        (messages * self.message_us + steps_us) * 1e-6
    }

    /// The largest such demand that asks for no more than these cores: its agents.
    fn most(&self, demand: Demand, cores: f64) -> usize {
        let of = |agents: &usize| demand.of(*agents);
        (1..=usize::from(u8::MAX)).take_while(|agents| self.cores(of(agents)) <= cores).last().unwrap_or(0)
    }
}

/// Agents on one PC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Demand {
    /// That many run there.
    pub agents: usize,
    /// The vehicles of their swarm, those on other PCs too.
    pub swarm: usize,
    /// A program on this PC listens to every step of theirs.
    pub traces: bool,
}

impl Demand {
    /// A whole swarm that `skein fly` flies and records here.
    fn whole(vehicles: usize) -> Self {
        Self { agents: vehicles, swarm: vehicles, traces: true }
    }

    /// With another number of agents, of the same swarm or of one that is all here.
    fn of(self, agents: usize) -> Self {
        let swarm = if self.agents == self.swarm { agents } else { self.swarm };
        Self { agents, swarm, ..self }
    }

    /// Whether any PC with so many cores carries it, without a measurement.
    pub fn is_small(self, cores: usize) -> bool {
        let unmeasured = UNMEASURED_A_CORE * cores;
        self.agents * self.swarm.saturating_sub(1) <= unmeasured * (unmeasured - 1)
    }
}

/// Measures whether these agents fit onto this PC; why not, with figures, or `None` if they do.
///
/// # Errors
/// If it cannot be measured.
pub fn exceeded_by(demand: Demand) -> Result<Option<String>, Error> {
    let cores = os::cores();
    if demand.is_small(cores) {
        return Ok(None);
    }
    Ok(Costs::measure()?.and_then(|costs| finding(&costs, demand, cores)))
}

/// Measures whether so many agents fit onto this PC. If they do not, asks whoever sits at the terminal; without one, refuses.
///
/// # Errors
/// If they do not fit and nobody wants it all the same, or if it cannot be measured.
pub fn ask_for(vehicles: usize, anyway: bool) -> Result<(), Error> {
    let (demand, cores) = (Demand::whole(vehicles), os::cores());
    if anyway || demand.is_small(cores) {
        return Ok(());
    }
    eprintln!("measuring what this PC carries");
    let Some(costs) = Costs::measure()? else { return Ok(()) };
    check_demand(&costs, demand, cores, agrees)
}

/// Why these agents do not fit onto so many cores; `None` if they do.
fn finding(costs: &Costs, demand: Demand, cores: usize) -> Option<String> {
    let (needed, most) = (costs.cores(demand), costs.most(demand, cores as f64));
    (needed > cores as f64).then(|| {
        let agents =
            if demand.agents == 1 { "1 agent asks".to_owned() } else { format!("{} agents ask", demand.agents) };
        format!(
            "{agents} for {needed:.1} cores and this PC has {cores}: it carries {most} (measured just now: {:.0} us of \
             processor for a message, {:.0} messages a second of each agent to each other)",
            costs.message_us,
            costs.states_hz + costs.heartbeat_hz
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

/// Asks whoever sits at the terminal whether to fly all the same; without one, no.
pub fn agrees(finding: &str) -> bool {
    if !io::stdin().is_terminal() || !io::stderr().is_terminal() {
        return false;
    }
    eprint!("{finding}. Fly all the same? [y/N] ");
    let _ = io::stderr().flush();
    let mut answer = String::new();
    io::stdin().lock().read_line(&mut answer).is_ok() && matches!(answer.trim(), "y" | "Y" | "yes")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What was measured on a PC with two cores.
    const COSTS: Costs = Costs {
        message_us: 100.0,
        states_hz: 5.0,
        heartbeat_hz: 5.0,
        step: StepTime { alone_us: 10.0, per_peer_us: 0.0 },
    };

    #[test]
    fn the_cost_grows_with_the_pairs() {
        // 64 × 63 × 10 messages and 64 × 50 traces of 100 us, 64 × 50 steps of 10 us.
        assert!((COSTS.cores(Demand::whole(64)) - (4.032 + 0.32 + 0.032)).abs() < 1e-9);
        let most = COSTS.most(Demand::whole(64), 2.0);
        assert!(COSTS.cores(Demand::whole(most)) <= 2.0 && COSTS.cores(Demand::whole(most + 1)) > 2.0, "{most}");
        assert_eq!(COSTS.most(Demand::whole(64), 0.0), 0);
    }

    #[test]
    fn a_host_carries_its_agents_of_a_swarm_that_is_spread_over_many() {
        let of_many = Demand { agents: 16, swarm: 128, traces: false };
        // 16 × 127 × 10 messages of 100 us, 16 × 50 steps of 10 us.
        assert!((COSTS.cores(of_many) - (2.032 + 0.008)).abs() < 1e-9);
        assert_eq!(COSTS.most(of_many, 2.0), 15);
        let said = finding(&COSTS, of_many, 2).unwrap();
        assert!(said.starts_with("16 agents ask for 2.0 cores and this PC has 2: it carries 15 ("), "{said}");
        assert_eq!(finding(&COSTS, Demand { agents: 15, ..of_many }, 2), None);
        assert!(Demand { agents: 1, swarm: 13, traces: false }.is_small(1) && !of_many.is_small(2));
    }

    #[test]
    fn a_swarm_that_does_not_fit_is_refused_with_a_figure_unless_its_user_wants_it() {
        assert!(check_demand(&COSTS, Demand::whole(32), 2, |_| panic!("asked")).is_ok());
        assert!(check_demand(&COSTS, Demand::whole(64), 2, |_| true).is_ok());
        let refused = check_demand(&COSTS, Demand::whole(64), 2, |_| false).unwrap_err();
        assert_eq!(refused.exit_code(), 2);
        let most = COSTS.most(Demand::whole(64), 2.0);
        let said = refused.to_string();
        assert!(
            said.starts_with(&format!("64 agents ask for 4.4 cores and this PC has 2: it carries {most} (")),
            "{said}"
        );
        assert!(said.contains(&format!("--set swarm.vehicles={most}")) && said.ends_with("--anyway"), "{said}");
    }

    #[test]
    fn what_an_agent_costs_is_measured() {
        let Some(costs) = Costs::measure().unwrap() else { return };
        assert!(costs.message_us > 0.0 && costs.message_us < 20_000.0, "{costs:?}");
        assert!(costs.states_hz >= 4.0 && costs.step.alone_us > 0.1, "{costs:?}");
        assert!(ask_for(1, false).is_ok());
    }
}
