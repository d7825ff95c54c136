//! Result for each node, as a table and as JSON.

use serde::Serialize;

use crate::findings;
use crate::inventory::Node;
use crate::nodes::{Outcome, above_zero};

/// The result for a node at which nothing was changed. The others are `installed` for the first time, `upgraded` from another
/// version, `rolled-back` to the earlier one, `written` as a folder to carry there, and `failed`.
pub(super) const UNCHANGED: &str = "unchanged";

/// Result for one node.
#[derive(Clone, Debug, Serialize)]
pub(super) struct InstalledNode {
    /// The result, with the duration without the restart.
    #[serde(flatten)]
    pub(super) outcome: Outcome,
    /// Duration of connecting and probing, s.
    pub(super) probe_s: f64,
    pub(super) copied_bytes: u64,
    pub(super) copy_s: f64,
    /// Duration of installing the configuration, s.
    pub(super) apply_s: f64,
    /// Time from the order to land until the vehicle was ready again, s.
    pub(super) restart_s: Option<f64>,
}

impl InstalledNode {
    pub(super) fn new(node: &Node) -> Self {
        let outcome = Outcome { done: UNCHANGED, ..Outcome::new(node) };
        Self { outcome, probe_s: 0.0, copied_bytes: 0, copy_s: 0.0, apply_s: 0.0, restart_s: None }
    }
}

/// Formats the results as a table.
pub(super) fn table(rows: &[InstalledNode], dry_run: bool) -> String {
    let is_restarted = rows.iter().any(|row| row.restart_s.is_some());
    let mut header = vec!["node", "host", "done", "all s", "copied MB", "copying s"];
    header.extend(is_restarted.then_some("restart s"));
    header.push("");
    let cells = |row: &InstalledNode| {
        let restart = is_restarted.then(|| row.restart_s.map_or_else(String::new, above_zero));
        let copied = [above_zero(row.copied_bytes as f64 * 1e-6), above_zero(row.copy_s)];
        row.outcome.row(copied.into_iter().chain(restart))
    };
    let note = if dry_run { "nothing was changed: this is what would be done\n" } else { "" };
    findings::table(&header, rows.iter().map(cells)) + note
}

/// Formats a number of bytes in MB.
pub(super) fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 * 1e-6)
}
