//! Axes: from quantities to shares of a length, and the numbers beside them.

use skein_common::math;

/// One axis of a panel.
#[derive(Clone, Debug)]
pub struct Axis {
    /// The quantity with its unit.
    pub label: String,
    is_log: bool,
    range: Option<[f64; 2]>,
    includes: Vec<f64>,
    named: Vec<(f64, String)>,
}

impl Axis {
    /// The axis of a quantity with its unit; for pure numbers the unit is "1", which is not printed.
    pub fn new(quantity: &str, unit: &str) -> Self {
        let label = if unit == "1" { quantity.to_owned() } else { format!("{quantity}, {unit}") };
        Self { label, is_log: false, range: None, includes: Vec::new(), named: Vec::new() }
    }

    /// An axis of names, each at its number.
    pub fn named(of_what: &str, names: Vec<(f64, String)>) -> Self {
        let ends = names.iter().map(|(at, _)| *at);
        let range = ends.clone().reduce(f64::min).zip(ends.reduce(f64::max)).map(|(low, high)| [low - 0.6, high + 0.6]);
        Self { label: of_what.to_owned(), is_log: false, range, includes: Vec::new(), named: names }
    }

    /// The same in equal steps of ratio. What is not above zero is left out.
    pub fn log(self) -> Self {
        Self { is_log: true, ..self }
    }

    /// The same from here to there, whatever the panel holds.
    pub fn within(self, from: f64, to: f64) -> Self {
        Self { range: Some([from, to]), ..self }
    }

    /// The same, with this number on it.
    pub fn including(mut self, number: f64) -> Self {
        self.includes.push(number);
        self
    }

    /// It has names in place of numbers.
    pub(super) fn is_named(&self) -> bool {
        !self.named.is_empty()
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.named.iter().map(|(_, name)| name.as_str())
    }

    /// The scale for these numbers; `padding` is the share of their span that is left free at either end.
    pub(super) fn scale(&self, numbers: impl Iterator<Item = f64>, padding: f64) -> Scale {
        let on_it = |number: f64| if self.is_log { math::log10(number) } else { number };
        if let Some([from, to]) = self.range.filter(|[from, to]| to > from) {
            return Scale { from: on_it(from), to: on_it(to), is_log: self.is_log };
        }
        let known = |number: &f64| number.is_finite();
        let all = || self.includes.iter().copied().map(on_it).filter(known);
        let numbers = numbers.map(on_it).filter(known);
        let (mut from, mut to) = numbers
            .chain(all())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to), number| (from.min(number), to.max(number)));
        if from > to {
            (from, to) = (0.0, 1.0);
        }
        // Of what hardly varies, the variation is not shown as large.
        let least = if self.is_log { 0.5 } else { 1e-9_f64.max((from.abs() + to.abs()) * 1e-3) };
        if to - from < least && from == 0.0 && self.includes.contains(&0.0) {
            to = 1.0;
        } else if to - from < least {
            let half = if from == to && !self.is_log { from.abs().max(1.0) * 0.1 } else { least };
            (from, to) = (from - half, to + half);
        }
        let room = padding * (to - from);
        let is_bound = |end: f64| all().any(|number| number == end);
        let from = if is_bound(from) { from } else { from - room };
        let to = if is_bound(to) { to } else { to + room };
        Scale { from, to, is_log: self.is_log }
    }

    /// Numbers to print and where, if one takes up `apart_px` of `length_px`.
    pub(super) fn ticks(&self, scale: &Scale, length_px: f64, apart_px: f64) -> Vec<(f64, String)> {
        let room = (length_px / apart_px).max(1.0);
        if !self.named.is_empty() {
            let every = (self.named.len() as f64 / room).ceil().max(1.0) as usize;
            let inside = |(at, _): &&(f64, String)| (0.0..=1.0).contains(&scale.share(*at));
            return self.named.iter().filter(inside).step_by(every).cloned().collect();
        }
        if scale.is_log { scale.decades(room) } else { scale.even(room) }
    }
}

/// The scale of an axis, which gives each number its place on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale {
    /// On a logarithmic axis, of the exponents.
    from: f64,
    to: f64,
    is_log: bool,
}

impl Scale {
    /// The place of a number as a share of the axis from its beginning.
    pub(super) fn share(&self, number: f64) -> f64 {
        let on_it = if self.is_log { math::log10(number) } else { number };
        (on_it - self.from) / (self.to - self.from)
    }

    /// From the beginning to the end, in units of the axis.
    pub(super) fn span(&self) -> f64 {
        self.to - self.from
    }

    /// The same with its middle where it was and this span.
    pub(super) fn widened(self, span: f64) -> Self {
        let middle = (self.from + self.to) / 2.0;
        Self { from: middle - span / 2.0, to: middle + span / 2.0, ..self }
    }

    /// Multiples of 1, 2 or 5 times a power of ten.
    fn even(&self, room: f64) -> Vec<(f64, String)> {
        let least = self.span() / room;
        let magnitude = math::pow(10.0, math::log10(least).floor());
        let steps = [0.2, 0.5, 1.0, 2.0, 5.0, 10.0].map(|times| times * magnitude);
        let fits = steps.iter().position(|step| *step >= least).unwrap_or(steps.len() - 1);
        // A single number does not show the scale.
        let is_alone = |step: f64| (self.to / step + 1e-6).floor() - (self.from / step - 1e-6).ceil() < 1.0;
        let step = if is_alone(steps[fits]) { steps[fits - 1] } else { steps[fits] };
        let decimals = (-math::log10(step) - 1e-9).floor() as i32 + 1;
        let decimals = if step >= 1.0 - 1e-9 { 0 } else { decimals.max(0) as usize };
        let first = (self.from / step - 1e-6).ceil() as i64;
        let last = (self.to / step + 1e-6).floor() as i64;
        (first..=last)
            .map(|nth| nth as f64 * step)
            .map(|number| (number, grouped(&printed(number, decimals))))
            .collect()
    }

    /// Powers of ten, and 2 and 5 times them where there is room.
    fn decades(&self, room: f64) -> Vec<(f64, String)> {
        let times: &[f64] = if self.span() * 3.0 <= room { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let every = (self.span() / room).ceil().max(1.0) as i32;
        let powers = (self.from.floor() as i32..=self.to.ceil() as i32).filter(|power| power.rem_euclid(every) == 0);
        let numbers =
            powers.flat_map(|power| times.iter().map(move |times| (power, times * math::pow(10.0, power.into()))));
        let inside = |number: f64| (-1e-9..=1.0 + 1e-9).contains(&self.share(number));
        let number = |(power, number): (i32, f64)| (number, grouped(&printed(number, (-power).max(0) as usize)));
        numbers.filter(|(_, number)| inside(*number)).map(number).collect()
    }
}

/// With this many decimals and a real minus sign.
fn printed(number: f64, decimals: usize) -> String {
    let text = format!("{number:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|byte| matches!(byte, b'0' | b'.')) => digits.to_owned(),
        Some(digits) => format!("\u{2212}{digits}"),
        None => text,
    }
}

/// Large whole numbers in groups of three.
fn grouped(text: &str) -> String {
    if text.len() < 5 || !text.bytes().all(|byte| byte.is_ascii_digit()) {
        return text.to_owned();
    }
    let digits = text.as_bytes();
    let groups = digits.rchunks(3).rev().map(|group| String::from_utf8_lossy(group).into_owned());
    groups.collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn texts(axis: &Axis, numbers: &[f64], length_px: f64) -> Vec<String> {
        let scale = axis.scale(numbers.iter().copied(), 0.0);
        axis.ticks(&scale, length_px, 80.0).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn ticks_are_round_numbers_and_as_many_as_fit() {
        let axis = Axis::new("time", "s");
        assert_eq!(axis.label, "time, s");
        assert_eq!(texts(&axis, &[0.0, 400.0], 800.0), ["0", "50", "100", "150", "200", "250", "300", "350", "400"]);
        assert_eq!(texts(&axis, &[0.0, 400.0], 300.0), ["0", "200", "400"]);
        let minus = "\u{2212}";
        let around_zero = [format!("{minus}400"), format!("{minus}200"), "0".into(), "200".into(), "400".into()];
        assert_eq!(texts(&axis, &[-460.0, 460.0], 320.0), around_zero, "more than one");
        assert_eq!(texts(&axis, &[-0.1, 0.1], 400.0), ["\u{2212}0.10", "\u{2212}0.05", "0.00", "0.05", "0.10"]);
        assert_eq!(texts(&axis.log(), &[1.0, 10_000.0], 400.0), ["1", "10", "100", "1000", "10,000"]);
    }

    #[test]
    fn nothing_and_one_number_have_a_scale_too() {
        let axis = Axis::new("time", "s");
        for numbers in [&[][..], &[5.0], &[0.0, 0.0], &[f64::NAN, 3.0]] {
            let scale = axis.scale(numbers.iter().copied(), 0.05);
            assert!(scale.span() > 0.0 && scale.span().is_finite(), "{numbers:?}: {scale:?}");
            assert!(!axis.ticks(&scale, 500.0, 80.0).is_empty(), "{numbers:?}");
        }
        assert_eq!(Axis::new("share", "%").including(0.0).scale([10.0].into_iter(), 0.1).from, 0.0);
    }

    #[test]
    fn names_are_thinned_out_where_they_would_overlap() {
        let axis = Axis::named("vehicle", (1..=50).map(|id| (f64::from(id), id.to_string())).collect());
        let scale = axis.scale(std::iter::empty(), 0.0);
        assert_eq!(axis.ticks(&scale, 1000.0, 20.0).len(), 50);
        assert_eq!(axis.ticks(&scale, 300.0, 20.0).len(), 13);
    }

    proptest! {
        #[test]
        fn ticks_ascend_within_the_axis_and_do_not_crowd(
            from in -1e6..1e6, width in 1e-3..1e6, length_px in 100.0..1000.0, apart_px in 15.0..90.0,
        ) {
            let axis = Axis::new("time", "s").within(from, from + width);
            let scale = axis.scale(std::iter::empty(), 0.0);
            let ticks = axis.ticks(&scale, length_px, apart_px);
            let shares: Vec<f64> = ticks.iter().map(|(number, _)| scale.share(*number)).collect();
            prop_assert!(shares.iter().all(|share| (-1e-6..=1.0 + 1e-6).contains(share)), "{:?}", ticks);
            prop_assert!(shares.is_sorted_by(|one, other| one < other), "{:?}", ticks);
            // One more than fit where a single number would not show the scale.
            prop_assert!(ticks.len() as f64 <= f64::max(length_px / apart_px + 1.0 + 1e-6, 6.0), "{:?}", ticks);
        }

        #[test]
        fn ticks_of_a_logarithmic_axis_ascend_within_it(from in 1e-6..1e3, times in 1.1..1e9, length_px in 100.0..1000.0) {
            let axis = Axis::new("ratio", "1").within(from, from * times).log();
            let scale = axis.scale(std::iter::empty(), 0.0);
            let ticks = axis.ticks(&scale, length_px, 40.0);
            prop_assert!(ticks.iter().all(|(number, _)| (-1e-6..=1.0 + 1e-6).contains(&scale.share(*number))), "{:?}", ticks);
            prop_assert!(ticks.is_sorted_by(|(one, _), (other, _)| one < other), "{:?}", ticks);
        }

        #[test]
        fn a_scale_holds_all_its_numbers(numbers in prop::collection::vec(-1e6..1e6, 0..20), padding in 0.0..0.2, zero: bool) {
            let axis = if zero { Axis::new("time", "s").including(0.0) } else { Axis::new("time", "s") };
            let scale = axis.scale(numbers.iter().copied(), padding);
            let held = numbers.iter().copied().chain(zero.then_some(0.0));
            prop_assert!(held.into_iter().all(|number| (-1e-9..=1.0 + 1e-9).contains(&scale.share(number))), "{:?}", scale);
        }
    }
}
