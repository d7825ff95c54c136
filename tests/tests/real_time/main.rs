//! What users run, as processes in real time: flights, pages, clients, the book's commands, and agents and whole clusters on hosts
//! of their own. The tests run side by side: each has its own swarm, folders and ports, and a
//! [`Share`](skein_tests::share::Share) of the processors, for which it waits.
#![cfg(unix)]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

mod book;
mod clients;
#[cfg(target_os = "linux")]
mod cluster;
mod default_formation;
mod external;
mod far;
mod fly;
mod fly_fleet;
mod garbage;
#[cfg(target_os = "linux")]
mod namespaces;
mod node_host;
mod octave;
mod one_pc;
mod operator;
mod overload;
mod own_plant;
mod page;
mod recording;
mod replay;
mod series;
mod slow_reader;
mod view;
