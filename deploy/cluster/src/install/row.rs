//! Result for each node, as a table and as JSON.

use serde::Serialize;
use skein_common::id::VehicleName;

use crate::findings;
use crate::inventory::Node;
use crate::nodes;
use crate::protocol::Installed;

/// The change that was made on a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Done {
    /// Installed for the first time.
    Installed,
    /// Replaced by another version.
    Upgraded,
    /// Nothing was changed.
    Unchanged,
    /// The earlier version was restored.
    RolledBack,
    /// A folder to carry there was written.
    Written,
    /// It failed: see `why`.
    Failed,
}

impl Done {
    fn name(self) -> &'static str {
        match self {
            Self::Installed => "installed",
            Self::Upgraded => "upgraded",
            Self::Unchanged => "unchanged",
            Self::RolledBack => "rolled back",
            Self::Written => "written",
            Self::Failed => "failed",
        }
    }
}

/// Result for one node.
#[derive(Clone, Debug, Serialize)]
pub(super) struct InstalledNode {
    pub(super) node: VehicleName,
    pub(super) host: String,
    pub(super) done: Done,
    /// Why it failed, or what is wrong.
    pub(super) why: Option<String>,
    /// Additional information that is not a fault.
    pub(super) note: Option<String>,
    /// The program and configuration of the next start.
    #[serde(flatten)]
    pub(super) runs: Option<Installed>,
    /// Duration without the restart, s.
    pub(super) seconds: f64,
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
        Self {
            node: node.id,
            host: nodes::place(node),
            done: Done::Unchanged,
            why: None,
            note: None,
            runs: None,
            seconds: 0.0,
            probe_s: 0.0,
            copied_bytes: 0,
            copy_s: 0.0,
            apply_s: 0.0,
            restart_s: None,
        }
    }

    pub(super) fn fail(&mut self, why: String) {
        self.done = Done::Failed;
        self.why = Some(why);
    }

    /// Formats the result as a line of progress.
    pub(super) fn to_text(&self) -> String {
        match &self.why {
            Some(why) => format!("node {} {}: {why}", self.node, self.done.name()),
            None => format!("node {} {}", self.node, self.done.name()),
        }
    }
}

/// Formats the results as a table.
pub(super) fn table(rows: &[InstalledNode], dry_run: bool) -> String {
    let restarted = rows.iter().any(|row| row.restart_s.is_some());
    let mut header = vec!["node", "host", "done", "all s", "copied MB", "copying s"];
    header.extend(restarted.then_some("restart s"));
    header.push("");
    let cells = |row: &InstalledNode| {
        let number = |value: f64| if value > 0.0 { format!("{value:.1}") } else { String::new() };
        let mut cells = vec![row.node.to_string(), row.host.clone(), row.done.name().to_owned(), number(row.seconds)];
        cells.extend([number(row.copied_bytes as f64 * 1e-6), number(row.copy_s)]);
        cells.extend(restarted.then(|| row.restart_s.map_or_else(String::new, number)));
        cells.push(row.why.clone().or_else(|| row.note.clone()).unwrap_or_default());
        cells
    };
    let note = if dry_run { "nothing was changed: this is what would be done\n" } else { "" };
    findings::table(&header, rows.iter().map(cells)) + note
}

/// Formats a number of bytes in MB.
pub(super) fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 * 1e-6)
}
