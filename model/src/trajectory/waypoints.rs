//! Through given postures at given times, along a cubic spline that starts and ends at rest.
//!
//! A cubic spline has two free parameters a link. Natural ends spend them on zero acceleration and leave a velocity
//! that jumps when the chain then stops; clamped ends leave an acceleration that jumps. Here one knot is added in the
//! first and one in the last segment, with angles left free, which pays for both: velocity and acceleration vanish at
//! the ends, and the trajectory, held before and after, is twice continuously differentiable at all times.
//!
//! With h_k the length of segment k, w_k the acceleration at knot k and w_0 = w_n = 0, continuity of the velocity is
//!
//! ```text
//! h_{k−1} w_{k−1}/6 + (h_{k−1} + h_k) w_k/3 + h_k w_{k+1}/6 = (q_{k+1} − q_k)/h_k − (q_k − q_{k−1})/h_{k−1}
//! ```
//!
//! and zero velocity at the ends makes the added angles q_1 = q_0 + h_0² w_1/6 and q_{n−1} = q_n + h_{n−1}² w_{n−1}/6.
//! An added knot halves its segment (or divides it in three, if the two are in one), so the system, tridiagonal for
//! each link, is diagonally dominant and has exactly one solution.

mod file;

use super::{SetpointValue, SupNorms, TrajectoryError, all_finite, per_link};
use crate::chain::Vector;

/// A path through waypoints, ready to be evaluated.
#[derive(Clone, Debug, PartialEq)]
pub struct Waypoints<const N: usize> {
    segments: Vec<Segment<N>>,
    end_s: f64,
    end_rad: Vector<N>,
    norms: SupNorms,
}

/// q = q_0 + v_0 s + w_0 s²/2 + j s³/6 with s the time since the segment's start.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Segment<const N: usize> {
    start_s: f64,
    duration_s: f64,
    q_rad: Vector<N>,
    v_rad_s: Vector<N>,
    w_rad_s2: Vector<N>,
    jerk_rad_s3: Vector<N>,
}

/// A knot of the spline: its time, and its angle as known + share · w, where share is 0 but for the added knots.
struct Knot<const N: usize> {
    t_s: f64,
    known_rad: Vector<N>,
    share_s2: f64,
}

impl<const N: usize> Waypoints<N> {
    /// The spline through `points`, each a time (s) and the angles there (rad): at least 2, times increasing.
    ///
    /// # Errors
    /// Names what was found and what is allowed.
    pub fn through(points: &[(f64, Vector<N>)]) -> Result<Self, TrajectoryError> {
        let Some(((first_s, _), (last_s, last_rad))) = points.first().zip(points.last()).filter(|_| points.len() > 1)
        else {
            let value = points.len() as f64;
            return Err(TrajectoryError::Parameter { field: "number of waypoints", value, allowed: "2 or more" });
        };
        for (t_s, q_rad) in points {
            all_finite("t_s", &[*t_s])?;
            all_finite("q", q_rad.as_slice())?;
        }
        if let Some(pair) = points.windows(2).find(|pair| pair[1].0 <= pair[0].0) {
            let allowed = "later than the waypoint before";
            return Err(TrajectoryError::Parameter { field: "t_s", value: pair[1].0, allowed });
        }
        let knots = with_added_knots(points);
        let w = accelerations(&knots);
        let segments: Vec<_> = (0..knots.len() - 1).map(|k| Segment::between(&knots, &w, k)).collect();
        let norms = sup_norms(&segments);
        let path = Self { segments, end_s: *last_s, end_rad: *last_rad, norms };
        if [norms.v_inf, norms.v_2, norms.a_2, last_s - first_s].iter().all(|x| x.is_finite()) {
            Ok(path)
        } else {
            let allowed = "a finite number (the waypoints are too far apart, or too close in time)";
            Err(TrajectoryError::Parameter { field: "acceleration", value: norms.a_2, allowed })
        }
    }

    /// The spline through the waypoints of a file of comma-separated values, which messages call `path`: a time and N
    /// angles a line. A first line of names says which column is what, in which unit; without it they are t_s, q1 … qN
    /// (s, rad).
    ///
    /// # Errors
    /// The first line that is refused: its number, what is wrong with it, what is allowed.
    pub fn from_csv_text(text: &str, path: &str) -> Result<Self, TrajectoryError> {
        let refuse = |line: usize, problem: String| TrajectoryError::Line { path: path.to_owned(), line, problem };
        let read = file::read::<N>(text).map_err(|(line, problem)| refuse(line, problem))?;
        Self::through(&read.points).map_err(|error| refuse(read.last_line, error.to_string()))
    }

    /// Whether a file's text names its columns.
    #[must_use]
    pub fn has_names(text: &str) -> bool {
        file::has_names(text)
    }

    /// When the motion begins and ends, s.
    #[must_use]
    pub fn span_s(&self) -> [f64; 2] {
        [self.segments[0].start_s, self.end_s]
    }

    /// The setpoint at `t_s`; the first and the last waypoint are held before and after.
    #[must_use]
    pub fn at(&self, t_s: f64) -> SetpointValue<N> {
        if t_s >= self.end_s {
            return per_link(|i| [self.end_rad[i], 0.0, 0.0]);
        }
        let later = self.segments.partition_point(|segment| segment.start_s <= t_s);
        if later == 0 {
            return per_link(|i| [self.segments[0].q_rad[i], 0.0, 0.0]);
        }
        let segment = &self.segments[later - 1];
        let s = t_s - segment.start_s;
        per_link(|i| {
            let (q, v) = (segment.q_rad[i], segment.v_rad_s[i]);
            let (w, jerk) = (segment.w_rad_s2[i], segment.jerk_rad_s3[i]);
            [q + s * (v + s * (0.5 * w + s * (jerk / 6.0))), v + s * (w + s * (0.5 * jerk)), w + s * jerk]
        })
    }

    /// Bounds of Assumption 1; v_∞ and a_d are attained, v_2 takes each link's largest velocity in a segment.
    #[must_use]
    pub fn sup_norms(&self) -> SupNorms {
        self.norms
    }
}

impl<const N: usize> Segment<N> {
    /// The cubic between knots k and k + 1 with the accelerations w there.
    fn between(knots: &[Knot<N>], w: &[Vector<N>], k: usize) -> Self {
        let angle = |k: usize| knots[k].known_rad + w[k] * knots[k].share_s2;
        let duration_s = knots[k + 1].t_s - knots[k].t_s;
        let slope = (angle(k + 1) - angle(k)) / duration_s;
        Self {
            start_s: knots[k].t_s,
            duration_s,
            q_rad: angle(k),
            v_rad_s: slope - (w[k] * 2.0 + w[k + 1]) * (duration_s / 6.0),
            w_rad_s2: w[k],
            jerk_rad_s3: (w[k + 1] - w[k]) / duration_s,
        }
    }

    /// The largest |v_i| in the segment: v_i is a parabola, so it is at an end or at the vertex.
    fn speed_max_rad_s(&self, i: usize) -> f64 {
        let (v, w, jerk, end_s) = (self.v_rad_s[i], self.w_rad_s2[i], self.jerk_rad_s3[i], self.duration_s);
        let at = |s: f64| (v + s * (w + s * (0.5 * jerk))).abs();
        let vertex_s = -w / jerk;
        let inside = vertex_s > 0.0 && vertex_s < end_s;
        at(0.0).max(at(end_s)).max(if inside { at(vertex_s) } else { 0.0 })
    }
}

/// The waypoints and the two added knots, whose angles are those of the nearest end plus h² w/6.
fn with_added_knots<const N: usize>(points: &[(f64, Vector<N>)]) -> Vec<Knot<N>> {
    let last = points.len() - 1;
    // Where in its segment the first added knot is; the other one is where a mirror would put it.
    let fraction = if last == 1 { 1.0 / 3.0 } else { 0.5 };
    let first_step_s = (points[1].0 - points[0].0) * fraction;
    let last_step_s = (points[last].0 - points[last - 1].0) * fraction;
    let given = |&(t_s, known_rad): &(f64, Vector<N>)| Knot { t_s, known_rad, share_s2: 0.0 };
    let added = |t_s: f64, known_rad: Vector<N>, step_s: f64| Knot { t_s, known_rad, share_s2: step_s * step_s / 6.0 };
    let mut knots = vec![given(&points[0]), added(points[0].0 + first_step_s, points[0].1, first_step_s)];
    knots.extend(points[1..last].iter().map(given));
    knots.push(added(points[last].0 - last_step_s, points[last].1, last_step_s));
    knots.push(given(&points[last]));
    knots
}

/// The accelerations at the knots: elimination on the tridiagonal system, for all links at once.
fn accelerations<const N: usize>(knots: &[Knot<N>]) -> Vec<Vector<N>> {
    let last = knots.len() - 1;
    let mut w = vec![Vector::<N>::zeros(); knots.len()];
    // After elimination row k reads w_k + above[k] w_{k+1} = w[k].
    let mut above = vec![0.0; knots.len()];
    for k in 1..last {
        let (before, here, after) = (&knots[k - 1], &knots[k], &knots[k + 1]);
        let (h0, h1) = (here.t_s - before.t_s, after.t_s - here.t_s);
        let low = h0 / 6.0 - before.share_s2 / h0;
        let diagonal = (h0 + h1) / 3.0 + here.share_s2 * (1.0 / h0 + 1.0 / h1);
        let high = h1 / 6.0 - after.share_s2 / h1;
        let rhs = (after.known_rad - here.known_rad) / h1 - (here.known_rad - before.known_rad) / h0;
        let pivot = diagonal - low * above[k - 1];
        above[k] = high / pivot;
        w[k] = (rhs - w[k - 1] * low) / pivot;
    }
    for k in (1..last).rev() {
        let correction = w[k + 1] * above[k];
        w[k] -= correction;
    }
    w
}

/// |q̈_d| is convex on a segment, where q̈_d is linear, so its supremum is at a knot.
fn sup_norms<const N: usize>(segments: &[Segment<N>]) -> SupNorms {
    let mut norms = SupNorms { v_inf: 0.0, v_2: 0.0, a_2: 0.0 };
    for segment in segments {
        let speed = Vector::<N>::from_fn(|i, _| segment.speed_max_rad_s(i));
        norms.v_inf = norms.v_inf.max(speed.amax());
        norms.v_2 = norms.v_2.max(speed.norm());
        let end = segment.w_rad_s2 + segment.jerk_rad_s3 * segment.duration_s;
        norms.a_2 = norms.a_2.max(segment.w_rad_s2.norm()).max(end.norm());
    }
    // max() passes over what is not a number; a spline that is not finite must not look harmless.
    let finite = segments.iter().all(|s| s.q_rad.iter().chain(&s.v_rad_s).chain(&s.jerk_rad_s3).all(|x| x.is_finite()));
    if finite { norms } else { SupNorms { v_inf: f64::INFINITY, v_2: f64::INFINITY, a_2: f64::INFINITY } }
}
