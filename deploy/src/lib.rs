//! The `skein` command for operators and researchers: it flies a swarm on this PC, studies one in virtual time and
//! shows the results. The command is never in the control loop: if it is killed, the swarm flies on.

pub mod capacity;
pub mod check;
pub mod cli;
pub mod cluster;
pub mod display;
pub mod endpoints;
pub mod explain;
mod findings;
pub mod fit;
pub mod fly;
pub mod inventory;
pub mod keys;
pub mod landing;
pub mod manual;
pub mod new;
pub mod observe;
pub mod order;
pub mod os;
pub mod place;
pub mod ports;
pub mod prepare;
pub mod reach;
pub mod record;
pub mod release;
pub mod replay;
pub mod report;
pub mod sample;
pub mod scenarios;
pub mod simulators;
pub mod status;
pub mod version;
pub mod view;
