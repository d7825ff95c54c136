//! Laws that run in the process of the study: no messages, no timeout.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_core::formation::external::{LawQuery, LawReply};
use skein_host::external::protocol::{Hello, Time};

use super::LawError;
use crate::world::World;

/// The laws of all vehicles of one run. They answer as a program does that follows the protocol.
pub trait LocalLaws: fmt::Debug + Send {
    /// Begins the law of one vehicle: before the run, and again when the vehicle's agent has restarted.
    ///
    /// # Errors
    /// A sentence with the reason why the law cannot begin. It ends the run.
    fn begin(&mut self, hello: &Hello) -> Result<(), String>;

    /// Answers a query.
    ///
    /// # Errors
    /// A sentence with the reason why the law does not answer. The run fails with it.
    fn answer(&mut self, query: &LawQuery) -> Result<LawReply, String>;
}

/// Makes the laws of a run, one set for each run that flies at the same time.
#[derive(Clone)]
pub struct LawMaker(Arc<dyn Fn() -> Box<dyn LocalLaws> + Send + Sync>);

impl LawMaker {
    /// Makes the laws of each run with this function.
    pub fn new(make: impl Fn() -> Box<dyn LocalLaws> + Send + Sync + 'static) -> Self {
        Self(Arc::new(make))
    }
}

impl fmt::Debug for LawMaker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("LawMaker")
    }
}

/// Local laws during one run.
#[derive(Debug)]
pub struct LocalRun {
    laws: Box<dyn LocalLaws>,
    /// The hello with which each vehicle's law begins, and whether its agent has sent a query in this run.
    hellos: BTreeMap<VehicleId, (Hello, bool)>,
}

impl LocalRun {
    pub(super) fn begin(maker: &LawMaker, scenario: &Scenario) -> Result<Self, LawError> {
        let hellos = scenario.ids().map(|id| (id, (Hello::new(scenario, id, Time::Virtual), false)));
        let mut run = Self { laws: (maker.0)(), hellos: hellos.collect() };
        for (id, (hello, _)) in &run.hellos {
            run.laws.begin(hello).map_err(|why| LawError::Local(*id, why))?;
        }
        Ok(run)
    }

    pub(super) fn serve(&mut self, world: &mut World) -> Result<(), LawError> {
        for query in world.take_asks() {
            let failed = |why| LawError::Local(query.vehicle, why);
            if query.tick == 0
                && let Some((hello, has_asked)) = self.hellos.get_mut(&query.vehicle)
            {
                // A restarted agent needs a restarted law.
                if std::mem::replace(has_asked, true) {
                    self.laws.begin(hello).map_err(failed)?;
                }
            }
            world.answer(self.laws.answer(&query).map_err(failed)?);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Mutex, PoisonError};

    use skein_common::scenario::{Source, load};
    use skein_core::aircraft::Aircraft;
    use skein_core::control::Rules;
    use skein_core::formation::external::ReplyCommand;

    use super::super::LawPool;
    use super::*;
    use crate::study::Study;

    /// Flies to the centre; fails at this tick of vehicle 2.
    #[derive(Debug)]
    struct Gather {
        begun: Arc<Mutex<Vec<u8>>>,
        fails_at: Option<u64>,
    }

    impl LocalLaws for Gather {
        fn begin(&mut self, hello: &Hello) -> Result<(), String> {
            self.begun.lock().unwrap_or_else(PoisonError::into_inner).push(hello.vehicle.get());
            Ok(())
        }

        fn answer(&mut self, query: &LawQuery) -> Result<LawReply, String> {
            if self.fails_at == Some(query.tick) && query.vehicle.get() == 2 {
                return Err("it divides by zero".to_owned());
            }
            let to_centre = query.goal.centre - query.own.position;
            let command = ReplyCommand::VelocityNed(0.1 * to_centre);
            let (vehicle, tick) = (query.vehicle, query.tick);
            Ok(LawReply { vehicle, tick, command, heading_rad: None, reached: None, log: Vec::new() })
        }
    }

    fn study(fails_at: Option<u64>) -> (Study, Arc<Mutex<Vec<u8>>>) {
        let text = "duration_s = 20\nswarm.vehicles = 2\nformation.law = 'external'\n\
                    formation.external.command = ['sh']\n\
                    mission.events = [{ at_s = 5, fault = 'kill', vehicle = 2, for_s = 3 }]\n";
        let scenario = load(&Source { name: "test", text }, &[]).unwrap().scenario;
        let aircraft = vec![Aircraft::shipped("xcell60").unwrap().unwrap(); scenario.swarm.vehicles];
        let begun = Arc::default();
        let of_each = Arc::clone(&begun);
        let maker = LawMaker::new(move || Box::new(Gather { begun: Arc::clone(&of_each), fails_at }));
        (Study { scenario, aircraft, rules: Rules::shipped(), laws: LawPool::local(maker) }, begun)
    }

    #[test]
    fn a_law_in_this_process_flies_and_begins_anew_with_a_restarted_agent() {
        let (study, begun) = study(None);
        let report = study.fly(1).unwrap();
        assert_eq!(*begun.lock().unwrap(), [1, 2, 2]);
        assert_eq!(report.law_misses, Some(0));
    }

    #[test]
    fn a_law_that_fails_ends_the_run_with_its_reason() {
        let error = study(Some(3)).0.fly(1).unwrap_err().to_string();
        assert_eq!(error, "the law of vehicle 2: it divides by zero");
    }
}
