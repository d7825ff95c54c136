//! Everything that a crate with its own formation law needs from Skein.
//!
//! One vehicle's controller asks its [`Law`] for a velocity command at every step. [`Laws`] gives the law a name for
//! scenario files, and [`cli::main_with`](crate::cli::main_with) makes a study program with it. The function of the
//! same name in the crate `skein` makes a program with every command of `skein`: that one also flies live swarms, but
//! takes minutes to compile. The law's parameters are the free table `[formation.parameters]` of the scenario.
//!
//! ```no_run
//! use skein_lab::law::{Law, LawCommand, LawOutput, Laws, Observation, number};
//!
//! /// Flies every vehicle straight to the centre.
//! #[derive(Clone, Debug)]
//! struct Gather {
//!     gain_per_s: f64,
//! }
//!
//! impl Law for Gather {
//!     fn update(&mut self, observation: &Observation<'_>) -> LawOutput {
//!         let to_centre_ne_m = -observation.from_centre_ne_m();
//!         let command = LawCommand::level(to_centre_ne_m * self.gain_per_s);
//!         LawOutput { command, reached: to_centre_ne_m.norm() < 3.0 }
//!     }
//! }
//!
//! fn main() -> std::process::ExitCode {
//!     let laws = Laws::default().with("gather", |setup| {
//!         Ok(Box::new(Gather { gain_per_s: number(setup, "gain_per_s", 0.3)? }))
//!     });
//!     skein_lab::cli::main_with(laws)
//! }
//! ```

pub use nalgebra::{Rotation2, Vector2, Vector3};
pub use skein_common::frame::{PositionNed, VelocityNed};
pub use skein_common::id::VehicleId;
/// Elementary functions that give the same bits on every computer: a law that uses them is as repeatable as Skein's
/// own.
pub use skein_common::math;
pub use skein_core::formation::law::{
    Goal, Law, LawCommand, LawOutput, Neighbour, Observation, Obstacle, Setup, number,
};
pub use skein_core::formation::laws::{Laws, MakeLaw};
pub use skein_core::formation::slots::Slots;
