//! The section of a scenario about the motion to be followed.

use super::named_file::NamedFile;
use super::names::ReferenceKind;
use super::units::Nanos;
use super::values::PerLink;
use serde::{Deserialize, Serialize};

/// `[reference]`: the motion to be followed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct ReferenceSection {
    /// Its shape.
    pub kind: ReferenceKind,
    /// How far ahead setpoints are published; default the larger of 64 ticks and 20 ms.
    pub lead: Option<Nanos>,
    /// Amplitude of `sine` and `chirp` (rad); default 1.
    pub amplitude_rad: Option<PerLink>,
    /// Angular frequency of `sine` and `circle` (rad/s); default 0.1.
    pub omega_rad_s: Option<PerLink>,
    /// The sines of `multi-sine`.
    pub term: Vec<SineTerm>,
    /// Mean of `multi-sine` (rad); default 0.
    pub offset_rad: Option<PerLink>,
    /// Start of `quintic` (rad); default 0.
    pub from_rad: Option<PerLink>,
    /// End of `quintic` (rad).
    pub to_rad: Option<PerLink>,
    /// Beginning of the motion of `quintic`; default 0.
    pub at: Option<Nanos>,
    /// Length of the motion of `quintic`, or of the sweep of `chirp`.
    pub duration: Option<Nanos>,
    /// Angular frequency at the start of `chirp` (rad/s); default 0.1.
    pub omega_start_rad_s: Option<f64>,
    /// Angular frequency at the end of `chirp` (rad/s).
    pub omega_end_rad_s: Option<f64>,
    /// Centre of `circle` from the hinge, horizontal and upward (m).
    pub centre_m: Option<[f64; 2]>,
    /// Radius of `circle` (m).
    pub radius_m: Option<f64>,
    /// Place of the tip on `circle` at t = 0, from the right (rad); default 0.
    pub phase_rad: Option<f64>,
    /// Whether `circle` bends the chain to the larger angles of its first part; default true.
    pub elbow_positive: Option<bool>,
    /// CSV file of `waypoints` with columns for the time and each joint, named or in the order t_s, q1 … qn.
    pub file: Option<NamedFile>,
}

impl Default for ReferenceSection {
    fn default() -> Self {
        Self {
            kind: ReferenceKind::Sine,
            lead: None,
            amplitude_rad: None,
            omega_rad_s: None,
            term: Vec::new(),
            offset_rad: None,
            from_rad: None,
            to_rad: None,
            at: None,
            duration: None,
            omega_start_rad_s: None,
            omega_end_rad_s: None,
            centre_m: None,
            radius_m: None,
            phase_rad: None,
            elbow_positive: None,
            file: None,
        }
    }
}

/// `[[reference.term]]`: one sine of a `multi-sine`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
pub struct SineTerm {
    /// rad.
    pub amplitude_rad: PerLink,
    /// rad/s.
    pub omega_rad_s: PerLink,
    /// rad; default 0.
    #[serde(default = "zero")]
    pub phase_rad: PerLink,
}

fn zero() -> PerLink {
    PerLink::All(0.0)
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

impl ReferenceSection {
    /// The typed form for a chain of `links`; keys that the kind does not have are ignored.
    #[must_use]
    pub fn motion(&self, links: usize) -> Motion {
        let vector = |values: &Option<PerLink>, default: f64| {
            values.as_ref().map_or_else(|| vec![default; links], |values| values.to_vec(links))
        };
        match self.kind {
            ReferenceKind::Sine => Motion::Sine {
                amplitude_rad: vector(&self.amplitude_rad, 1.0),
                omega_rad_s: vector(&self.omega_rad_s, 0.1),
            },
            ReferenceKind::MultiSine => {
                let each = |t: &SineTerm| {
                    (t.amplitude_rad.to_vec(links), t.omega_rad_s.to_vec(links), t.phase_rad.to_vec(links))
                };
                Motion::MultiSine {
                    offset_rad: vector(&self.offset_rad, 0.0),
                    terms: self.term.iter().map(each).collect(),
                }
            }
            ReferenceKind::Quintic => Motion::Quintic {
                from_rad: vector(&self.from_rad, 0.0),
                to_rad: vector(&self.to_rad, 0.0),
                at_s: self.at.unwrap_or_default().seconds(),
                duration_s: self.duration.unwrap_or_default().seconds(),
            },
            ReferenceKind::Chirp => Motion::Chirp {
                amplitude_rad: vector(&self.amplitude_rad, 1.0),
                omega_start_rad_s: self.omega_start_rad_s.unwrap_or(0.1),
                omega_end_rad_s: self.omega_end_rad_s.unwrap_or(0.1),
                duration_s: self.duration.unwrap_or_default().seconds(),
            },
            ReferenceKind::Circle => Motion::Circle {
                centre_m: self.centre_m.unwrap_or_default(),
                radius_m: self.radius_m.unwrap_or(0.0),
                omega_rad_s: self.omega_rad_s.as_ref().and_then(|w| w.written().first().copied()).unwrap_or(0.1),
                phase_rad: self.phase_rad.unwrap_or(0.0),
                elbow_positive: self.elbow_positive.unwrap_or(true),
            },
            ReferenceKind::Waypoints => Motion::Waypoints { file: self.file.clone().unwrap_or_default() },
        }
    }

    /// How far ahead of the present setpoints are published (ns).
    #[must_use]
    pub fn lead_ns(&self, period_ns: u64) -> u64 {
        self.lead.map_or((64 * period_ns).max(20_000_000), Nanos::ns)
    }
}
