//! Services of the PC that both an agent and a study need and the core must not use: clocks, the files that a scenario
//! names, formation laws in other programs, threads for independent tasks, the widest vectors. The swarm's network is not among them.

pub mod atomic_file;
pub mod blocks;
pub mod clock;
pub mod external;
pub mod files;
pub mod parallel;
pub mod process;
