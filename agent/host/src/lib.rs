//! What an agent and a study both need of the PC that they run on, and the core must not have: clocks, the files that a
//! scenario names, and formation laws in other programs, threads for independent tasks. No network of the swarm's is here.

pub mod clock;
pub mod external;
pub mod files;
pub mod parallel;
pub mod process;
pub mod whole;
