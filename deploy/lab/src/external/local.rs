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

/// The laws of all vehicles of one run. They answer as a program does that speaks the protocol.
pub trait LocalLaws: fmt::Debug + Send {
    /// Begins the law of one vehicle: before the run, and again when the vehicle's agent has restarted.
    ///
    /// # Errors
    /// A sentence with the reason why the law cannot begin. It ends the run.
    fn begin(&mut self, hello: &Hello) -> Result<(), String>;

    /// Answers a query.
    ///
    /// # Errors
    /// A sentence with the reason why there is no answer. It ends the run.
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
    /// What each vehicle's law begins with, and whether its agent has sent a query in this run.
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
