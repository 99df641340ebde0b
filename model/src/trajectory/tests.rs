//! Trajectories: derivatives against differences, bounds against dense samples, waypoints against their conditions.

use super::*;
use crate::chain::tip_position;

const PI: f64 = core::f64::consts::PI;

fn circle(phase_rad: f64, elbow_positive: bool) -> CircleParameters<3> {
    CircleParameters {
        length_m: [1.0, 0.7, 0.5],
        centre_m: [0.3, -1.4],
        radius_m: 0.4,
        omega_rad_s: 1.3,
        phase_rad,
        elbow_positive,
    }
}

fn waypoints(points: &[(f64, [f64; 3])]) -> Waypoints<3> {
    Waypoints::through(&points.iter().map(|&(t, q)| (t, Vector::from(q))).collect::<Vec<_>>()).unwrap()
}

fn term(amplitude_rad: f64, omega_rad_s: f64, phase_rad: f64) -> SineTerm {
    SineTerm { amplitude_rad, omega_rad_s, phase_rad }
}

/// One of each kind, with its name for messages.
fn each_kind() -> Vec<(&'static str, Trajectory<3>)> {
    let amplitude_rad = [1.0, -0.5, 0.8];
    let terms = [vec![term(0.5, 2.0, 0.3), term(-0.2, 5.0, 1.0)], vec![], vec![term(1.0, 0.7, 0.0)]];
    let path = [(0.5, [0.0, 0.1, 0.2]), (1.0, [0.5, -0.2, 0.2]), (2.2, [0.3, 0.4, 0.2]), (3.0, [-0.4, 0.0, 0.2])];
    vec![
        ("paper", Trajectory::of_the_paper()),
        ("sine", Trajectory::Sine { amplitude_rad, omega_rad_s: [2.0, 3.0, 0.0] }),
        ("multisine", Trajectory::MultiSine { offset_rad: [0.1, 0.2, 0.3], terms }),
        (
            "quintic",
            Trajectory::Quintic { from_rad: [0.0, 1.0, -1.0], to_rad: [1.0, 0.5, 1.0], start_s: 0.5, duration_s: 2.0 },
        ),
        ("chirp", Trajectory::Chirp { amplitude_rad, omega_from_rad_s: 1.0, omega_to_rad_s: 6.0, duration_s: 3.0 }),
        // Through a frequency of 0, where the rate of the frequency is all of the acceleration.
        (
            "chirp there and back",
            Trajectory::Chirp { amplitude_rad, omega_from_rad_s: -1.0, omega_to_rad_s: 1.0, duration_s: 1.0 },
        ),
        ("circle", Trajectory::Circle(Circle::new(circle(0.4, true)).unwrap())),
        ("circle, other elbow", Trajectory::Circle(Circle::new(circle(0.4, false)).unwrap())),
        ("waypoints", Trajectory::Waypoints(waypoints(&path))),
        ("two waypoints", Trajectory::Waypoints(waypoints(&[path[0], path[3]]))),
    ]
}

#[test]
fn velocity_and_acceleration_are_the_derivatives_and_are_continuous_at_all_times() {
    let h = 1e-4;
    for (name, trajectory) in each_kind() {
        trajectory.validate().unwrap();
        for k in -200..1000 {
            let t = f64::from(k) * 0.005;
            let [before, here, after] = [t - h, t, t + h].map(|t| trajectory.at(t));
            // Central differences across every joint in time: a jump of q̈ by 1 would show as h/4 and 1/2 here.
            let v = (after.q_d - before.q_d) / (2.0 * h);
            let a = (after.v_d - before.v_d) / (2.0 * h);
            assert!((v - here.v_d).amax() < 2e-6, "{name} at {t}: velocity");
            assert!((a - here.a_d).amax() < 1e-2, "{name} at {t}: acceleration");
            assert!((after.a_d - before.a_d).amax() < 0.2, "{name} at {t}: the acceleration jumps");
        }
    }
}

#[test]
fn no_sample_exceeds_the_bounds_of_assumption_one_and_the_attained_ones_are_approached() {
    for (name, trajectory) in each_kind() {
        let norms = trajectory.sup_norms();
        let mut largest = SupNorms { v_inf: 0.0, v_2: 0.0, a_2: 0.0 };
        for k in -1000..70_000 {
            let setpoint = trajectory.at(f64::from(k) * 1e-3);
            largest.v_inf = largest.v_inf.max(setpoint.v_d.amax());
            largest.v_2 = largest.v_2.max(setpoint.v_d.norm());
            largest.a_2 = largest.a_2.max(setpoint.a_d.norm());
        }
        for (found, bound) in [(largest.v_inf, norms.v_inf), (largest.v_2, norms.v_2), (largest.a_2, norms.a_2)] {
            assert!(found <= bound * (1.0 + 1e-12), "{name}: {found} exceeds {bound}");
            // A bound may be loose, but one that is off by this factor would make every certificate void.
            assert!(bound <= 12.0 * found, "{name}: {bound} for {found}");
        }
        if ["paper", "quintic", "two waypoints"].contains(&name) {
            assert!(norms.v_inf < 1.0001 * largest.v_inf && norms.v_2 < 1.0001 * largest.v_2, "{name}");
            assert!(norms.a_2 < 1.001 * largest.a_2, "{name}");
        }
        if name == "waypoints" {
            assert!(norms.v_inf < 1.0001 * largest.v_inf && norms.a_2 < 1.01 * largest.a_2, "{name}");
        }
    }
}

#[test]
fn the_papers_reference_has_the_documented_norms() {
    let norms = Trajectory::<3>::of_the_paper().sup_norms();
    let root = 3.0_f64.sqrt();
    assert!((norms.v_inf - 0.1).abs() < 1e-15);
    assert!((norms.v_2 - 0.1 * root).abs() < 1e-15);
    assert!((norms.a_2 - 0.01 * root).abs() < 1e-15);
}

#[test]
fn extrapolation_errs_by_the_third_order() {
    let trajectory = Trajectory::<2>::Sine { amplitude_rad: [1.0, 2.0], omega_rad_s: [3.0, 1.0] };
    for delta in [-1e-2, 1e-3, 1e-2] {
        let (guess, truth) = (trajectory.at(0.7).extrapolate(delta), trajectory.at(0.7 + delta));
        let cube = (delta * delta * delta).abs();
        // The third derivative is at most 27.
        assert!((guess.q_d - truth.q_d).amax() <= 27.0 * cube / 6.0 + 1e-15);
        assert!((guess.v_d - truth.v_d).amax() <= 27.0 * delta * delta / 2.0 + 1e-15);
    }
    assert_eq!(trajectory.at(0.7).extrapolate(0.0), trajectory.at(0.7));
}

#[test]
fn a_sweep_has_its_frequencies_before_and_after() {
    let (from, to) = (1.0, 6.0);
    let chirp =
        Trajectory::<1>::Chirp { amplitude_rad: [1.0], omega_from_rad_s: from, omega_to_rad_s: to, duration_s: 3.0 };
    let early = chirp.at(-0.4).q_d[0];
    assert!((early - libm::sin(-0.4 * from)).abs() < 1e-14);
    let (late, later) = (chirp.at(5.0), chirp.at(5.0 + 2.0 * PI / to));
    assert!((late.q_d - later.q_d).amax() < 1e-12 && (late.v_d - later.v_d).amax() < 1e-11);
}

#[test]
fn the_tip_goes_round_the_circle_with_either_elbow() {
    for elbow_positive in [true, false] {
        let parameters = circle(0.4, elbow_positive);
        let circle = Circle::new(parameters).unwrap();
        for k in 0..500 {
            let t = f64::from(k) * 0.02;
            let q = circle.at(t).q_d;
            let [x, y] = tip_position(&parameters.length_m, &q);
            let (sin, cos) = libm::sincos(1.3 * t + 0.4);
            let [dx, dy] = [x - (0.3 + 0.4 * cos), y - (-1.4 + 0.4 * sin)];
            assert!(dx.abs() < 1e-13 && dy.abs() < 1e-13, "t = {t}: off by {dx}, {dy}");
            assert_eq!(elbow_positive, q[0] > q[2], "the elbow changes sides at {t}");
        }
        // One turn later the angles are the same: nothing winds up.
        assert!((circle.at(0.3).q_d - circle.at(0.3 + 2.0 * PI / 1.3).q_d).amax() < 1e-13);
    }
}

#[test]
fn a_circle_above_the_hinge_does_not_jump_where_the_angle_of_the_tip_passes_half_a_turn() {
    let up = CircleParameters::<2> {
        length_m: [1.0, 1.0],
        centre_m: [0.0, 1.2],
        radius_m: 0.5,
        omega_rad_s: 1.0,
        phase_rad: 0.0,
        elbow_positive: true,
    };
    let circle = Circle::new(up).unwrap();
    for k in 0..2000 {
        let (here, next) = (circle.at(f64::from(k) * 0.01), circle.at(f64::from(k) * 0.01 + 0.01));
        assert!((next.q_d - here.q_d).amax() < 0.05);
    }
}

#[test]
fn circles_that_cannot_be_followed_are_refused_with_the_distances() {
    let refusal = |parameters| Circle::<3>::new(parameters).unwrap_err().to_string();
    let good = circle(0.0, true);
    let far = refusal(CircleParameters { radius_m: 0.9, ..good });
    assert!(far.contains("less than 2.1999") && far.contains("2.33"), "{far}");
    let around = refusal(CircleParameters { centre_m: [0.1, 0.0], ..good });
    assert!(around.contains("hinge outside of the circle"), "{around}");
    assert!(refusal(CircleParameters { radius_m: -0.1, ..good }).starts_with("radius_m is -0.1"));
    assert!(refusal(CircleParameters { length_m: [1.0, 0.0, 1.0], ..good }).starts_with("length_m is 0"));
    assert!(refusal(CircleParameters { omega_rad_s: f64::NAN, ..good }).starts_with("omega_rad_s is NaN"));
    let one = CircleParameters::<1> {
        length_m: [1.0],
        centre_m: [0.5, 0.0],
        radius_m: 0.1,
        omega_rad_s: 1.0,
        phase_rad: 0.0,
        elbow_positive: true,
    };
    assert!(matches!(Circle::new(one), Err(TrajectoryError::CircleOfOneLink)));
}

#[test]
fn parameters_out_of_range_are_refused_by_name() {
    let refusal = |trajectory: Trajectory<1>| trajectory.validate().unwrap_err().to_string();
    let sine = refusal(Trajectory::Sine { amplitude_rad: [f64::INFINITY], omega_rad_s: [1.0] });
    assert_eq!(sine, "amplitude_rad is inf, allowed: any finite number");
    let quintic = Trajectory::Quintic { from_rad: [0.0], to_rad: [1.0], start_s: 0.0, duration_s: 0.0 };
    assert_eq!(refusal(quintic), "duration_s is 0, allowed: a finite number > 0");
    let terms = [vec![term(1.0, 1.0, f64::NAN)]];
    assert!(refusal(Trajectory::MultiSine { offset_rad: [0.0], terms }).starts_with("phase_rad is NaN"));
}

#[test]
fn waypoints_are_passed_at_their_times_and_held_before_and_after() {
    let points = [(0.5, [0.0, 0.1, 0.2]), (1.0, [0.5, -0.2, 0.2]), (2.2, [0.3, 0.4, 0.2]), (3.0, [-0.4, 0.0, 0.2])];
    let path = waypoints(&points);
    for (t, q) in points {
        assert!((path.at(t).q_d - Vector::from(q)).amax() < 1e-14, "at {t}");
    }
    for (t, q) in [(-7.0, points[0].1), (0.5, points[0].1), (3.0, points[3].1), (90.0, points[3].1)] {
        let held = path.at(t);
        assert!((held.q_d - Vector::from(q)).amax() < 1e-15);
        assert!(held.v_d.amax() < 1e-13 && held.a_d.amax() < 1e-12, "at {t}");
    }
    assert!(path.at(1.7).v_d[2].abs() < 1e-15, "a link that has one angle everywhere moves");
}

#[test]
fn a_file_of_waypoints_is_read_with_or_without_a_line_of_names() {
    let bare = "0,0.0,0.1\r\n1.5, 1.0,-0.1\r\n";
    let with_names = "\u{feff}t_s,q1,q2\n0,0.0,0.1\n1.5,1.0,-0.1\n\n";
    let read = Waypoints::<2>::from_csv_text(with_names, "named").unwrap();
    assert_eq!(read, Waypoints::from_csv_text(bare, "bare").unwrap());
    assert!((read.at(1.5).q_d - Vector::<2>::new(1.0, -0.1)).amax() < 1e-15);
}

#[test]
fn a_bad_file_of_waypoints_is_refused_with_the_number_of_the_line() {
    let refusal = |text: &str| Waypoints::<2>::from_csv_text(text, "way.csv").unwrap_err().to_string();
    let head = "t_s,q1,q2\n0,1,2\n1,1,2\n";
    let cases = [
        (format!("{head}2,1\n"), "way.csv, line 4: 2 columns, allowed: 3"),
        (format!("{head}2,1,2,3\n"), "way.csv, line 4: 4 columns"),
        (format!("{head}2,,2\n"), "way.csv, line 4: q1 is \"\""),
        (format!("{head}2,1,nan\n"), "way.csv, line 4: q2 is \"nan\""),
        (format!("{head}inf,1,2\n"), "way.csv, line 4: t_s is \"inf\""),
        (format!("{head}2,1,north\n"), "way.csv, line 4: q2 is \"north\""),
        (format!("{head}\n2,1,2\n"), "way.csv, line 4: the line is empty"),
        (format!("{head}1,1,2\n"), "way.csv, line 4: t_s is 1, allowed: more than 1"),
        (format!("{head}2,1,2\n1.5,1,2\n"), "way.csv, line 5: t_s is 1.5, allowed: more than 2"),
        ("t_s,q1,q2\n0,1,2\n".to_owned(), "way.csv, line 2: the file ends after 1 waypoints"),
        (String::new(), "way.csv, line 1: the file ends after 0 waypoints"),
        ("0,1e12,0\n1e-300,-1e12,0\n".to_owned(), "way.csv, line 2: acceleration is"),
    ];
    for (text, expected) in cases {
        let found = refusal(&text);
        assert!(found.starts_with(expected), "{found:?} instead of {expected:?}");
    }
}
