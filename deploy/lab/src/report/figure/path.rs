//! Lines in pixels: cut to the plot, without points that nobody sees, in dashes.

use skein_common::math;

/// Smaller differences than this are not seen, px.
const UNSEEN_PX: f64 = 0.2;

/// The pieces of a line that lie within left, top, right, bottom.
pub(super) fn clipped(line: &[[f64; 2]], plot: [f64; 4]) -> Vec<Vec<[f64; 2]>> {
    let mut pieces: Vec<Vec<[f64; 2]>> = Vec::new();
    for pair in line.windows(2) {
        let Some([from, to]) = segment(pair[0], pair[1], plot) else { continue };
        match pieces.last_mut() {
            Some(piece) if piece.last() == Some(&from) => piece.push(to),
            _ => pieces.push(vec![from, to]),
        }
    }
    pieces
}

/// The part of a segment that lies within, after Y.-D. Liang & B. Barsky (1984).
fn segment(from: [f64; 2], to: [f64; 2], [left, top, right, bottom]: [f64; 4]) -> Option<[[f64; 2]; 2]> {
    let way = [to[0] - from[0], to[1] - from[1]];
    let (mut enters, mut leaves) = (0.0_f64, 1.0_f64);
    for (p, q) in
        [(-way[0], from[0] - left), (way[0], right - from[0]), (-way[1], from[1] - top), (way[1], bottom - from[1])]
    {
        if p == 0.0 && q < 0.0 {
            return None;
        } else if p < 0.0 {
            enters = enters.max(q / p);
        } else if p > 0.0 {
            leaves = leaves.min(q / p);
        }
    }
    // A whole segment keeps its own ends, so that neighbours stay joined.
    let at = |share: f64| match share {
        0.0 => from,
        1.0 => to,
        _ => [from[0] + share * way[0], from[1] + share * way[1]],
    };
    (enters <= leaves).then(|| [at(enters), at(leaves)])
}

/// The line without points that change nothing to be seen (Ramer, Douglas, Peucker).
pub(super) fn simplified(line: &[[f64; 2]]) -> Vec<[f64; 2]> {
    if line.len() < 3 {
        return line.to_vec();
    }
    let mut kept = vec![false; line.len()];
    (kept[0], kept[line.len() - 1]) = (true, true);
    let mut open = vec![(0, line.len() - 1)];
    while let Some((first, last)) = open.pop() {
        let farthest = (first + 1..last)
            .map(|nth| (nth, distance(line[nth], line[first], line[last])))
            .max_by(|one, other| one.1.total_cmp(&other.1));
        if let Some((nth, _)) = farthest.filter(|(_, away)| *away > UNSEEN_PX) {
            kept[nth] = true;
            open.extend([(first, nth), (nth, last)]);
        }
    }
    line.iter().zip(kept).filter_map(|(point, kept)| kept.then_some(*point)).collect()
}

/// Of a point from a segment.
fn distance(point: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let way = [to[0] - from[0], to[1] - from[1]];
    let off = [point[0] - from[0], point[1] - from[1]];
    let square = way[0] * way[0] + way[1] * way[1];
    let share = if square > 0.0 { ((off[0] * way[0] + off[1] * way[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    math::hypot(off[0] - share * way[0], off[1] - share * way[1])
}

/// The line in dashes as long as the gaps between them.
pub(super) fn dashes(line: &[[f64; 2]], dash_px: f64) -> Vec<Vec<[f64; 2]>> {
    let mut dashes = Vec::new();
    let (mut dash, mut is_drawn, mut left_px) = (Vec::new(), true, dash_px);
    for pair in line.windows(2) {
        let [mut from, to] = [pair[0], pair[1]];
        loop {
            let length = math::hypot(to[0] - from[0], to[1] - from[1]);
            if is_drawn && dash.is_empty() {
                dash.push(from);
            }
            if length <= left_px {
                left_px -= length;
                if is_drawn {
                    dash.push(to);
                }
                break;
            }
            let share = left_px / length;
            from = [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])];
            if is_drawn {
                dash.push(from);
                dashes.push(std::mem::take(&mut dash));
            }
            (is_drawn, left_px) = (!is_drawn, dash_px);
        }
    }
    dashes.extend((dash.len() > 1).then_some(dash));
    dashes
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLOT: [f64; 4] = [0.0, 0.0, 10.0, 10.0];

    #[test]
    fn a_line_is_cut_where_it_leaves_and_goes_on_where_it_comes_back() {
        let line = [[1.0, 1.0], [5.0, 1.0], [5.0, 15.0], [8.0, 15.0], [8.0, 5.0]];
        let pieces = clipped(&line, PLOT);
        assert_eq!(pieces, [vec![[1.0, 1.0], [5.0, 1.0], [5.0, 10.0]], vec![[8.0, 10.0], [8.0, 5.0]]]);
        assert!(clipped(&[[11.0, 0.0], [11.0, 10.0]], PLOT).is_empty());
        assert_eq!(clipped(&[[-5.0, 5.0], [15.0, 5.0]], PLOT), [[[0.0, 5.0], [10.0, 5.0]]]);
    }

    #[test]
    fn only_points_that_nobody_sees_are_left_out() {
        let straight: Vec<_> = (0..1000).map(|nth| [f64::from(nth), 3.0]).collect();
        assert_eq!(simplified(&straight), [[0.0, 3.0], [999.0, 3.0]]);
        let mut bent = straight;
        bent[500][1] = 4.0;
        assert!(simplified(&bent).contains(&[500.0, 4.0]));
        let back_and_forth = [[0.0, 0.0], [9.0, 0.0], [0.0, 0.0]];
        assert_eq!(simplified(&back_and_forth), back_and_forth);
    }

    #[test]
    fn dashes_go_around_corners() {
        let dashes = dashes(&[[0.0, 0.0], [3.0, 0.0], [3.0, 7.0]], 2.0);
        assert_eq!(dashes[0], [[0.0, 0.0], [2.0, 0.0]]);
        assert_eq!(dashes[1], [[3.0, 1.0], [3.0, 3.0]]);
        assert_eq!(dashes.len(), 3);
    }
}
