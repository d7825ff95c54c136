//! The `skein` command for operators and researchers: it flies a swarm on this PC, studies one in virtual time and
//! shows the results. The command is never in the control loop: if it is killed, the swarm flies on.

pub mod capacity;
pub mod check;
pub mod cli;
pub mod explain;
pub mod fit;
pub mod fly;
pub mod manual;
pub mod new;
pub mod prepare;
pub mod record;
pub mod release;
pub mod replay;
pub mod report;
pub mod scenarios;
pub mod version;
