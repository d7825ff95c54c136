//! Marks of injected faults and orders on all panels over time.

use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Order};

use super::Flight;
use crate::faults::InjectedFault;
use crate::recording::{NotedKind, Recording};
use crate::report::figure::{Mark, Panel};

/// Most marks that carry their texts; more marks carry numbers, and the caption lists their texts.
const FEW_MARKS: usize = 8;
/// Faults of the same kind within this time share a mark, s.
const TOGETHER_S: f64 = 0.5;

/// Adds the marks of the flight to a panel; returns the panel and the text about the marks for its caption.
pub(super) fn with_marks(flight: &Flight<'_>, panel: Panel) -> (Panel, String) {
    let mut marks: Vec<Mark> = injected(flight.recording).into_iter().map(|(x, text)| Mark { x, text }).collect();
    if marks.len() <= FEW_MARKS {
        return (Panel { marks, ..panel }, String::new());
    }
    let texts = marks.iter().enumerate().map(|(nth, mark)| format!("{} {} ({:.0} s)", nth + 1, mark.text, mark.x));
    let caption = format!(" Marks: {}.", texts.collect::<Vec<_>>().join(", "));
    marks.iter_mut().enumerate().for_each(|(nth, mark)| mark.text = (nth + 1).to_string());
    (Panel { marks, ..panel }, caption)
}

/// The faults that were injected and the orders that were given, each with its time, s. Those of one kind at about the same
/// time are one.
pub(in crate::report) fn injected(recording: &Recording) -> Vec<(f64, String)> {
    /// Faults of the same kind at about the same time.
    struct Sort {
        t_s: f64,
        who: Vec<VehicleId>,
        what: String,
    }
    let mut sorts: Vec<Sort> = Vec::new();
    let mut orders: Vec<Order> = Vec::new();
    for noted in &recording.noted {
        let (who, what) = match &noted.what {
            NotedKind::Fault(InjectedFault::Died(id)) => (Some(*id), "killed".to_owned()),
            NotedKind::Fault(InjectedFault::Restarted(id)) => (Some(*id), "restarted".to_owned()),
            NotedKind::Fault(InjectedFault::Failed(id, what)) => (Some(*id), what.replace('_', " ")),
            NotedKind::Fault(InjectedFault::Cut { .. }) => (None, "links cut".to_owned()),
            NotedKind::Fault(InjectedFault::Healed { .. }) => (None, "links healed".to_owned()),
            NotedKind::Fault(InjectedFault::Delayed { .. }) => (None, "links delayed".to_owned()),
            NotedKind::Fault(InjectedFault::DelayOver { .. }) => (None, "delay over".to_owned()),
            NotedKind::Event(_, EventKind::OrderTaken(order)) if !orders.contains(order) => {
                orders.push(*order);
                (None, format!("order: {order}"))
            }
            NotedKind::Event(..) => continue,
        };
        match sorts.iter_mut().rev().find(|sort| sort.what == what && noted.t_s - sort.t_s < TOGETHER_S) {
            Some(sort) => sort.who.extend(who.filter(|who| !sort.who.contains(who))),
            None => sorts.push(Sort { t_s: noted.t_s, who: who.into_iter().collect(), what }),
        }
    }
    sorts.sort_by(|one, other| one.t_s.total_cmp(&other.t_s));
    let text = |sort: Sort| {
        let who: Vec<_> = sort.who.iter().map(ToString::to_string).collect();
        let text = match who.len() {
            0 => sort.what,
            1..=4 => format!("{} {}", who.join(", "), sort.what),
            many => format!("{many} vehicles {}", sort.what),
        };
        (sort.t_s, text)
    };
    sorts.into_iter().map(text).collect()
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;
    use crate::metrics::Run;
    use crate::recording::Noted;
    use crate::report::figure::Axis;

    fn marked(noted: Vec<Noted>) -> (Vec<(f64, String)>, String) {
        let scenario = load(&Source { name: "x", text: "swarm.vehicles = 9" }, &[]).unwrap().scenario;
        let recording = Recording { noted, ..Recording::new(&scenario, Run::new(&scenario, "study")) };
        let panel = Panel::new(Axis::new("time", "s"), Axis::new("altitude", "m"));
        let (panel, caption) = with_marks(&Flight::new(&recording), panel);
        (panel.marks.into_iter().map(|mark| (mark.x, mark.text)).collect(), caption)
    }

    fn died(t_s: f64, id: u8) -> Noted {
        Noted { t_s, what: NotedKind::Fault(InjectedFault::Died(VehicleId::new(id).unwrap())) }
    }

    #[test]
    fn a_fault_of_several_vehicles_at_once_is_one_mark() {
        let (marks, caption) = marked(vec![died(20.0, 3), died(20.02, 4), died(30.0, 5)]);
        assert_eq!(marks, [(20.0, "3, 4 killed".to_owned()), (30.0, "5 killed".to_owned())]);
        assert_eq!(caption, "");
    }

    #[test]
    fn many_marks_have_numbers_and_their_texts_are_in_the_caption() {
        let (marks, caption) = marked((1..=9).map(|id| died(10.0 * f64::from(id), id)).collect());
        assert_eq!(marks[8], (90.0, "9".to_owned()));
        assert!(caption.contains("2 2 killed (20 s)"), "{caption}");
    }
}
