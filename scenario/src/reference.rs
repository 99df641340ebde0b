//! The section of a scenario about the motion to be followed.

use super::Scenario;
use super::key::{ABOVE_ZERO, FINITE, POSITIVE, key, section};
use super::named_file::NamedFile;
use super::names::ReferenceKind;
use super::units::Nanos;
use super::values::PerLink;

/// Sines of a reference, which are added up every tick.
const TERMS_MAX: usize = 100;

section! {
    /// The motion to be followed.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct ReferenceSection {
        /// Its shape.
        kind: ReferenceKind = ReferenceKind::Sine => key();
        /// How far ahead setpoints are published, 1 to 2000 periods.
        lead: Option<Nanos> = None, resolved |s, _| Some(Nanos(s.setpoint_lead_ns()))
            => key().otherwise("the larger of 64 ticks and 20 ms");
        /// Amplitude.
        amplitude_rad: Option<PerLink> = None, resolved |s, own| each(&own.amplitude_rad, 1.0, s)
            => key().unit("rad").of(&["sine", "chirp"]).within(FINITE).otherwise("`1`");
        /// Angular frequency. A circle has one number.
        omega_rad_s: Option<PerLink> = None, resolved |s, own| own.omega(s)
            => key().unit("rad/s").of(&["sine", "circle"]).within(FINITE).otherwise("`0.1`");
        /// The sines of multi-sine.
        term: Vec<ReferenceTerm> = Vec::new() => key().needed_by(&["multi-sine"]).at_most(TERMS_MAX);
        /// Mean.
        offset_rad: Option<PerLink> = None, resolved |s, own| each(&own.offset_rad, 0.0, s)
            => key().unit("rad").of(&["multi-sine"]).within(FINITE).otherwise("`0`").example("0");
        /// Start of the motion.
        from_rad: Option<PerLink> = None, resolved |s, own| each(&own.from_rad, 0.0, s)
            => key().unit("rad").of(&["quintic"]).within(FINITE).otherwise("`0`").example("0");
        /// End of the motion.
        to_rad: Option<PerLink> = None => key().unit("rad").needed_by(&["quintic"]).within(FINITE).example("[1, 0.5, 0]");
        /// When the motion begins.
        at: Option<Nanos> = None, resolved |_, own| Some(own.at.unwrap_or_default())
            => key().of(&["quintic"]).otherwise("`\"0s\"`").example("\"0s\"");
        /// Length of the motion, or of the rise in frequency.
        duration: Option<Nanos> = None
            => key().needed_by(&["quintic", "chirp"]).within(ABOVE_ZERO).example("\"5s\"");
        /// Angular frequency at the start.
        omega_start_rad_s: Option<f64> = None, resolved |_, own| Some(own.omega_start_rad_s.unwrap_or(0.1))
            => key().unit("rad/s").of(&["chirp"]).within(FINITE).otherwise("`0.1`").example("0.1");
        /// Angular frequency at the end.
        omega_end_rad_s: Option<f64> = None => key().unit("rad/s").needed_by(&["chirp"]).within(FINITE).example("2.0");
        /// Centre from the hinge, horizontal and upward.
        centre_m: Option<[f64; 2]> = None => key().unit("m").needed_by(&["circle"]).within(FINITE).example("[0.5, -1.5]");
        /// Radius.
        radius_m: Option<f64> = None => key().unit("m").needed_by(&["circle"]).within(POSITIVE).example("0.3");
        /// Angle of the tip on the circle at t = 0, from the right.
        phase_rad: Option<f64> = None, resolved |_, own| Some(own.phase_rad.unwrap_or(0.0))
            => key().unit("rad").of(&["circle"]).within(FINITE).otherwise("`0`").example("0");
        /// Whether the chain bends to the side where the angles of its first half are larger.
        elbow_positive: Option<bool> = None, resolved |_, own| Some(own.elbow_positive.unwrap_or(true))
            => key().of(&["circle"]).otherwise("`true`").example("true");
        /// A CSV file with a column for the time and one for each joint. [Below](#the-file-of-waypoints) is what it may contain.
        file: Option<NamedFile> = None => key().needed_by(&["waypoints"]).example("\"points.csv\"");
    }
}

section! {
    /// One sine of a multi-sine.
    #[serde(deny_unknown_fields, expecting = "a table")]
    pub struct ReferenceTerm {
        /// Amplitude.
        amplitude_rad: PerLink => key().unit("rad").within(FINITE).needed().example("0.5");
        /// Angular frequency.
        omega_rad_s: PerLink => key().unit("rad/s").within(FINITE).needed().example("0.3");
        /// Phase.
        #[serde(default = "zero")]
        phase_rad: PerLink => key().unit("rad").within(FINITE).otherwise("`0`").example("0");
    }
}

fn zero() -> PerLink {
    PerLink::All(0.0)
}

/// One number a link: as written, else the default.
fn each(written: &Option<PerLink>, default: f64, scenario: &Scenario) -> Option<PerLink> {
    let links = scenario.links();
    Some(PerLink::Each(written.as_ref().map_or_else(|| vec![default; links], |values| values.to_vec(links))))
}

/// A reference motion with every value in place, one a link.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// amplitude · sin(omega t).
    Sine {
        /// rad.
        amplitude_rad: Vec<f64>,
        /// rad/s.
        omega_rad_s: Vec<f64>,
    },
    /// offset + sum of amplitude · sin(omega t + phase).
    MultiSine {
        /// rad.
        offset_rad: Vec<f64>,
        /// (amplitude rad, omega rad/s, phase rad), each with one value a link.
        terms: Vec<(Vec<f64>, Vec<f64>, Vec<f64>)>,
    },
    /// Point to point.
    Quintic {
        /// rad.
        from_rad: Vec<f64>,
        /// rad.
        to_rad: Vec<f64>,
        /// s.
        at_s: f64,
        /// s.
        duration_s: f64,
    },
    /// A sine of rising frequency.
    Chirp {
        /// rad.
        amplitude_rad: Vec<f64>,
        /// rad/s.
        omega_start_rad_s: f64,
        /// rad/s.
        omega_end_rad_s: f64,
        /// s.
        duration_s: f64,
    },
    /// A circle of the tip.
    Circle {
        /// Horizontal and upward from the hinge (m).
        centre_m: [f64; 2],
        /// m.
        radius_m: f64,
        /// rad/s.
        omega_rad_s: f64,
        /// rad.
        phase_rad: f64,
        /// Whether the chain bends to the larger angles of its first part.
        elbow_positive: bool,
    },
    /// Points of a file.
    Waypoints {
        /// CSV.
        file: NamedFile,
    },
}

impl Scenario {
    /// The motion to be followed, with every value in place.
    #[must_use]
    pub fn motion(&self) -> Motion {
        let (own, links) = (self.resolved().reference, self.links());
        // What the kind needs is there, and what it may have is resolved: nothing is left out.
        let vector = |values: &Option<PerLink>| values.as_ref().map_or_else(Vec::new, |values| values.to_vec(links));
        let number = Option::<f64>::unwrap_or_default;
        match own.kind {
            ReferenceKind::Sine => {
                Motion::Sine { amplitude_rad: vector(&own.amplitude_rad), omega_rad_s: vector(&own.omega_rad_s) }
            }
            ReferenceKind::MultiSine => {
                let sine = |t: &ReferenceTerm| {
                    (t.amplitude_rad.to_vec(links), t.omega_rad_s.to_vec(links), t.phase_rad.to_vec(links))
                };
                Motion::MultiSine { offset_rad: vector(&own.offset_rad), terms: own.term.iter().map(sine).collect() }
            }
            ReferenceKind::Quintic => Motion::Quintic {
                from_rad: vector(&own.from_rad),
                to_rad: vector(&own.to_rad),
                at_s: own.at.unwrap_or_default().seconds(),
                duration_s: own.duration.unwrap_or_default().seconds(),
            },
            ReferenceKind::Chirp => Motion::Chirp {
                amplitude_rad: vector(&own.amplitude_rad),
                omega_start_rad_s: number(own.omega_start_rad_s),
                omega_end_rad_s: number(own.omega_end_rad_s),
                duration_s: own.duration.unwrap_or_default().seconds(),
            },
            ReferenceKind::Circle => Motion::Circle {
                centre_m: own.centre_m.unwrap_or_default(),
                radius_m: number(own.radius_m),
                omega_rad_s: own.omega_rad_s.as_ref().and_then(|w| w.written().first().copied()).unwrap_or_default(),
                phase_rad: number(own.phase_rad),
                elbow_positive: own.elbow_positive.unwrap_or_default(),
            },
            ReferenceKind::Waypoints => Motion::Waypoints { file: own.file.unwrap_or_default() },
        }
    }
}

impl ReferenceSection {
    /// The angular frequencies: one a link of a sine, one number of a circle.
    fn omega(&self, scenario: &Scenario) -> Option<PerLink> {
        match self.kind {
            ReferenceKind::Circle => Some(self.omega_rad_s.clone().unwrap_or(PerLink::All(0.1))),
            _ => each(&self.omega_rad_s, 0.1, scenario),
        }
    }

    /// How far ahead of the present setpoints are published (ns).
    #[must_use]
    pub fn lead_ns(&self, period_ns: u64) -> u64 {
        self.lead.map_or((64 * period_ns).max(20_000_000), Nanos::ns)
    }
}
