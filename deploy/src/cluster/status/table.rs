//! The table, for 120 columns.

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};

use super::{HealthReport, NodeStatus, SwarmStatus};

const HEADER: [&str; 14] = [
    "node", "version", "plant", "phase", "Hz", "jitter", "peers", "age", "clock ms", "links", "o/i", "fault",
    "refused", "uptime",
];
/// What every column shows, its unit, and which values are bad.
const LEGEND: [&str; 6] = [
    "version: the release that runs   plant: what moves   phase: what the vehicle does   uptime: since its agent started",
    "Hz: simulator frames per second   jitter: latest frame of the last second, ms; bad above a frame's period, 1000/Hz",
    "peers: in contact, of all others   age: of the oldest peer state, delay included, ms (> if a delay is unknown)",
    "clock ms: ahead of the swarm's clock, ± bound (! if more than 20 ms off; flight does not depend on it)",
    "links: with other agents and observers   o/i: messages published and received, a second, since its start",
    "fault: what has failed, named below   refused: messages not believed since the start, named below",
];
/// Columns with text; the others hold numbers.
const TEXT_COLUMNS: [usize; 3] = [1, 2, 3];

/// All of it; `file` is the cluster's as the user has named it.
pub(super) fn of(status: &SwarmStatus, file: &str) -> String {
    let mut table = Table::new();
    // On a narrower terminal, cells are wrapped at spaces.
    table.load_style(presets::NOTHING).set_header(HEADER).set_content_arrangement(ContentArrangement::Dynamic);
    for node in &status.nodes {
        table.add_row(row(node));
    }
    for (nth, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        if !TEXT_COLUMNS.contains(&nth) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    let lines = table.to_string();
    let mut text: String = lines.lines().map(|line| format!("{}\n", line.trim_end())).collect();
    LEGEND.iter().for_each(|line| text += &format!("{line}\n"));
    status.nodes.iter().for_each(|node| text += &notes(node));
    if status.nodes.iter().any(|node| node.report.is_none()) {
        text +=
            &format!("`skein check -f {file}` looks why not, `skein cluster logs -f {file}` shows what was written\n");
    }
    text
}

fn row(node: &NodeStatus) -> [String; 14] {
    let id = node.id.to_string();
    let Some(report) = &node.report else {
        let mut row = [(); 14].map(|()| "-".to_owned());
        row[0] = id;
        row[3] = "not in contact".to_owned();
        return row;
    };
    [
        id,
        report.version.clone(),
        report.plant.clone(),
        report.phase.clone(),
        format!("{:.0}", report.frame_rate_hz),
        format!("{:.1}", report.jitter_ms),
        format!("{}/{}", report.peers_seen, report.peers),
        age(report),
        clock(report),
        report.links.to_string(),
        format!("{:.0}/{:.0}", report.sent_per_s, report.received_per_s),
        if report.faults.is_empty() { "-".to_owned() } else { report.faults.len().to_string() },
        report.refused.to_string(),
        uptime(report.uptime_s),
    ]
}

/// The upper bound of the age; with `>` it lacks a delay that is not known yet.
fn age(report: &HealthReport) -> String {
    let mark = if report.peer_delay_ms.is_some() { "" } else { ">" };
    report.peer_age_ms.map_or("-".to_owned(), |age_ms| format!("{mark}{age_ms:.0}"))
}

/// `+0.1 ±0.3`, and a mark if it is far off. Seconds where milliseconds would not fit.
fn clock(report: &HealthReport) -> String {
    let (Some(offset), Some(bound)) = (report.clock_offset_ms, report.clock_bound_ms) else { return "-".to_owned() };
    let mark = if report.clock_is_off { "!" } else { "" };
    match offset.abs() < 1e4 {
        // Never minus zero.
        true => format!("{mark}{:+.1} ±{bound:.1}", (offset * 10.0).round() / 10.0 + 0.0),
        false => format!("{mark}{:+.0} s", offset / 1e3),
    }
}

/// The lines below the table: why a node is not in contact, and its faults and refusals.
fn notes(node: &NodeStatus) -> String {
    let id = node.id;
    let Some(report) = &node.report else {
        let host = node.host.as_deref().map(|host| format!("{host}, ")).unwrap_or_default();
        let why =
            node.why.as_ref().map(|why| format!(": it {why}; `skein cluster down`, then `up`")).unwrap_or_default();
        return format!("node {id} ({host}{}) is not in contact{why}\n", node.endpoint);
    };
    let mut text: String = report.faults.iter().map(|fault| format!("node {id}: {fault}\n")).collect();
    if report.clock_is_off {
        text += &format!(
            "node {id}: its clock is {:+.0} ms off; nothing in flight relies on it, but logs and recordings are read by it: \
             have it set by NTP (`timedatectl set-ntp true`)\n",
            report.clock_offset_ms.unwrap_or_default()
        );
    }
    for refusal in &report.refusals {
        let times = if refusal.count == 1 { "once" } else { &format!("{} times", refusal.count) };
        text += &format!("node {id} refused {times}: {}, under {}\n", refusal.reason, refusal.key);
    }
    text
}

/// `0:42`, `12:07`, `3:25:10`.
fn uptime(seconds: f64) -> String {
    let whole = seconds.max(0.0) as u64;
    match whole / 3600 {
        0 => format!("{}:{:02}", whole / 60, whole % 60),
        hours => format!("{hours}:{:02}:{:02}", whole / 60 % 60, whole % 60),
    }
}
