//! The view of a swarm on a terminal: `fly` shows its own flight with it, `view --terminal` that of another process.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`status`] | figures of every vehicle |
//! | [`journal`] | what happened, equal events of several vehicles in one line |
//! | [`table`], [`columns`], [`screen`] | the table, or lines where there is no terminal |

pub mod columns;
pub mod journal;
pub mod screen;
pub mod status;
pub mod table;
