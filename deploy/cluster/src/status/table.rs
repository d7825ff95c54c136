//! The table, for 120 columns. On a narrower terminal whole columns are left out, the least important first.

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};

use skein_common::id::TeamId;

use super::{HealthReport, NodeStatus, SwarmStatus};
use crate::display::status::shown_phase;

/// Largest fleet whose nodes have a row each; beyond it, each team has one, as in the table of `fly`.
const MAX_ROWS: usize = 16;

/// A column: its heading, its place in the order of importance, whether it holds text and not numbers, and its cell. Of the columns
/// that do not fit, the one with the greatest place is left out first.
type StatusColumn = (&'static str, u8, bool, fn(&HealthReport) -> String);

/// The columns after that of the node.
const COLUMNS: [StatusColumn; 13] = [
    ("version", 13, true, |report| report.version.clone()),
    ("plant", 12, true, |report| report.plant.clone()),
    (PHASE, 1, true, |report| shown_phase(&report.phase, report.in_place_s).to_owned()),
    ("Hz", 4, false, |report| format!("{:.0}", report.frame_rate_hz)),
    ("jitter", 8, false, |report| format!("{:.1}", report.jitter_ms)),
    ("peers", 5, false, |report| format!("{}/{}", report.peers_seen, report.peers)),
    ("age", 6, false, age),
    ("clock ms", 7, false, clock),
    ("links", 9, false, |report| report.links.to_string()),
    ("o/i", 10, false, |report| format!("{:.0}/{:.0}", report.sent_per_s, report.received_per_s)),
    (
        "fault",
        2,
        false,
        |report| if report.faults.is_empty() { "-".to_owned() } else { report.faults.len().to_string() },
    ),
    ("refused", 3, false, |report| report.refused.to_string()),
    ("uptime", 11, false, |report| uptime(report.uptime_s)),
];
const PHASE: &str = "phase";
/// Space after a column.
const PADDING: u16 = 2;
/// The meaning of every column, its unit, and which values are bad.
const LEGEND: [&str; 6] = [
    "version: the release that runs   plant: what moves   phase: formation if in its place   uptime: since its agent started",
    "Hz: simulator frames per second   jitter: latest frame of the last second, ms; bad above a frame's period, 1000/Hz",
    "peers: in contact, of all others   age: of the oldest peer state, delay included, ms (> if a delay is unknown)",
    "clock ms: ahead of the swarm's clock, ± bound (! if more than 20 ms off; flight does not depend on it)",
    "links: with other agents, without keys observers too   o/i: messages published and received, a second, since its start",
    "fault: what has failed, named below   refused: messages not believed since the start, named below",
];
/// The meaning of the rows of teams.
const OF_TEAMS: &str = "a row for each team, with its nodes in contact of all, and of each figure the worst of them; refused: of all of them";

/// All of it; `remedy` is the last line if a node is not in contact.
pub(super) fn of(status: &SwarmStatus, remedy: &str) -> String {
    let teams = if status.nodes.len() > MAX_ROWS { teams(status) } else { Vec::new() };
    let (first, rows): (&str, Vec<Vec<String>>) = if teams.is_empty() {
        ("node", status.nodes.iter().map(|node| row(node.id.to_string(), node.report.as_ref())).collect())
    } else {
        ("team", teams.iter().map(|(team, nodes)| team_row(*team, nodes)).collect())
    };
    let mut text = fitting(first, &rows, Table::new().width().map(usize::from));
    let of_teams = (!teams.is_empty()).then_some(OF_TEAMS);
    of_teams.iter().chain(&LEGEND).for_each(|line| text += &format!("{line}\n"));
    status.nodes.iter().for_each(|node| text += &notes(node));
    if status.nodes.iter().any(|node| node.report.is_none()) {
        text += &format!("{remedy}\n");
    }
    text
}

/// The table with the columns that fit into `room`, the first with this heading, and a line that counts the others.
fn fitting(first: &'static str, rows: &[Vec<String>], room: Option<usize>) -> String {
    // Heading, place in the order of importance, and whether it is text.
    let columns: Vec<(&str, u8, bool)> = [(first, 0, false)]
        .into_iter()
        .chain(COLUMNS.map(|(title, rank, is_text, _)| (title, rank, is_text)))
        .collect();
    let width = |nth: usize| {
        let cells = rows.iter().map(|row| row[nth].as_str()).chain([columns[nth].0]);
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0) + usize::from(PADDING)
    };
    let mut shown: Vec<usize> = (0..columns.len()).collect();
    // The space after the last column is not printed.
    let needed = |shown: &[usize]| shown.iter().map(|nth| width(*nth)).sum::<usize>().saturating_sub(PADDING.into());
    while shown.len() > 1 && room.is_some_and(|room| needed(&shown) > room) {
        let last = (0..shown.len()).max_by_key(|at| columns[shown[*at]].1);
        last.map(|at| shown.remove(at));
    }
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(shown.iter().map(|nth| columns[*nth].0));
    table.add_rows(rows.iter().map(|row| shown.iter().map(|nth| row[*nth].clone()).collect::<Vec<_>>()));
    for (column, nth) in table.column_iter_mut().zip(&shown) {
        column.set_padding((0, PADDING));
        if !columns[*nth].2 {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    let lines = table.to_string();
    let mut text: String = lines.lines().map(|line| format!("{}\n", line.trim_end())).collect();
    let hidden: Vec<&str> = (0..columns.len()).filter(|nth| !shown.contains(nth)).map(|nth| columns[nth].0).collect();
    if !hidden.is_empty() {
        text += &format!("no room for: {}; make the window wider\n", hidden.join(", "));
    }
    text
}

/// The nodes of each team of a fleet, in the order of the teams.
fn teams(status: &SwarmStatus) -> Vec<(TeamId, &[NodeStatus])> {
    let by_team = status.nodes.chunk_by(|one, next| one.team == next.team);
    by_team.filter_map(|nodes| Some((nodes.first()?.team?, nodes))).collect()
}

/// The row of a team: the worst of its nodes in contact.
fn team_row(team: TeamId, nodes: &[NodeStatus]) -> Vec<String> {
    let reports = nodes.iter().filter_map(|node| node.report.as_ref());
    let id = format!("{team} ({}/{})", reports.clone().count(), nodes.len());
    row(id, reports.cloned().reduce(worst).as_ref())
}

/// Both reports as one: of each figure the worse, all faults, and the sum of what was rejected.
fn worst(one: HealthReport, other: HealthReport) -> HealthReport {
    let text = |one: String, other: &String| if one == *other { one } else { "several".to_owned() };
    let most = |one: Option<f64>, other: Option<f64>| [one, other].into_iter().flatten().max_by(f64::total_cmp);
    let off = |report: &HealthReport| report.clock_offset_ms.map(f64::abs);
    let clock = if off(&other) > off(&one) { &other } else { &one };
    let (clock_offset_ms, clock_bound_ms) = (clock.clock_offset_ms, clock.clock_bound_ms);
    HealthReport {
        version: text(one.version, &other.version),
        plant: text(one.plant, &other.plant),
        phase: text(one.phase, &other.phase),
        in_place_s: one.in_place_s.zip(other.in_place_s).map(|(one, other)| one.min(other)),
        frame_rate_hz: one.frame_rate_hz.min(other.frame_rate_hz),
        jitter_ms: one.jitter_ms.max(other.jitter_ms),
        peers_seen: one.peers_seen.min(other.peers_seen),
        peers: one.peers,
        peer_age_ms: most(one.peer_age_ms, other.peer_age_ms),
        peer_delay_ms: one.peer_delay_ms.zip(other.peer_delay_ms).map(|(one, other)| one.max(other)),
        clock_offset_ms,
        clock_bound_ms,
        clock_is_off: one.clock_is_off || other.clock_is_off,
        faults: [one.faults, other.faults].concat(),
        wanted: Vec::new(),
        links: one.links.max(other.links),
        sent_per_s: one.sent_per_s.max(other.sent_per_s),
        received_per_s: one.received_per_s.max(other.received_per_s),
        bytes_per_s: [0, 1].map(|way| one.bytes_per_s[way].max(other.bytes_per_s[way])),
        unsent: one.unsent + other.unsent,
        refused: one.refused + other.refused,
        refusals: Vec::new(),
        uptime_s: one.uptime_s.min(other.uptime_s),
    }
}

fn row(id: String, report: Option<&HealthReport>) -> Vec<String> {
    let cell = |(title, _, _, cell): StatusColumn| match report {
        Some(report) => cell(report),
        None => if title == PHASE { "not in contact" } else { "-" }.to_owned(),
    };
    [id].into_iter().chain(COLUMNS.map(cell)).collect()
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
    let stated = report.faults.iter().chain(&report.wanted);
    let mut text: String = stated.map(|fault| format!("node {id}: {fault}\n")).collect();
    if report.clock_is_off {
        text += &format!(
            "node {id}: its clock is {:+.0} ms off; nothing in flight relies on it, but logs and recordings are read by it: \
             have it set by NTP (`timedatectl set-ntp true`)\n",
            report.clock_offset_ms.unwrap_or_default()
        );
    }
    if report.unsent > 0 {
        text += &format!(
            "node {id} did not send {} of its events, traces and health reports: the network from it is too slow, or its PC too busy; \
             fewer observers and a lower `record.hz` need less of both\n",
            report.unsent
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_width_shows_whole_columns_the_most_important_ones() {
        let cells = [
            "12/16",
            "0.1.0",
            "standin",
            "under way",
            "50",
            "12.3",
            "15/15",
            ">1234",
            "!+9999.9 ±123.4",
            "15",
            "123/4567",
            "3",
            "12345",
            "123:25:10",
        ];
        let rows = [cells.map(str::to_owned).to_vec(), row("3".to_owned(), None)];
        let title = |nth: usize| if nth == 0 { "node" } else { COLUMNS[nth - 1].0 };
        let rank = |nth: usize| if nth == 0 { 0 } else { COLUMNS[nth - 1].1 };
        let all: usize = fitting("node", &rows, None).lines().map(|line| line.chars().count()).max().unwrap();
        let mut before = 0;
        for room in 20..=200 {
            let text = fitting("node", &rows, Some(room));
            let lines: Vec<&str> = text.lines().collect();
            assert!(lines[..3].iter().all(|line| line.chars().count() <= room), "{room}: {text}");
            let shown: Vec<usize> =
                (0..14).filter(|nth| lines[1].split("  ").any(|cell| cell.trim() == cells[*nth])).collect();
            let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
            let expected =
                |of: &dyn Fn(usize) -> String| words(&shown.iter().map(|nth| of(*nth)).collect::<Vec<_>>().join(" "));
            assert_eq!(words(lines[0]), expected(&|nth| title(nth).to_owned()), "{room}: {text}");
            assert_eq!(words(lines[1]), expected(&|nth| cells[nth].to_owned()), "{room}: {text}");
            assert_eq!(words(lines[2]), expected(&|nth| rows[1][nth].clone()), "{room}: {text}");
            let ranks: std::collections::BTreeSet<u8> = shown.iter().map(|nth| rank(*nth)).collect();
            assert_eq!(ranks, (0..shown.len() as u8).collect(), "the most important ones, at {room}: {text}");
            assert!(shown.len() >= before);
            before = shown.len();
            assert_eq!(shown.len() == 14, room >= all && !text.contains("no room"), "{room}: {text}");
        }
        assert_eq!(before, 14);
    }
}
