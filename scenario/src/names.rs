//! The closed lists of words that a scenario may use, each with one spelling for files, command line and reports.

use loopbound_model::law::LawKind;
use loopbound_model::quote;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// The message for a word outside its list: what was found, what is allowed, and the nearest one.
pub(super) fn unknown_word(found: &str, allowed: &[&str]) -> String {
    let hint = quote::nearest(found, allowed.iter().copied()).map(|near| format!(", did you mean \"{near}\"?"));
    format!("found \"{}\", allowed: {}{}", quote::text(found), allowed.join(", "), hint.unwrap_or_default())
}

/// Reads the name of a law, and names the nearest one when there is none.
pub(super) fn law<'de, D: Deserializer<'de>>(deserializer: D) -> Result<LawKind, D::Error> {
    let name = String::deserialize(deserializer)?;
    name.parse().map_err(|_| serde::de::Error::custom(unknown_word(&name, &LawKind::ALL.map(LawKind::name))))
}

/// The same for a key that may be absent.
pub(super) fn optional_law<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<LawKind>, D::Error> {
    law(deserializer).map(Some)
}

/// Defines an enum of keywords with `ALL`, `name`, `Display`, `FromStr` and serde in the one spelling.
macro_rules! keywords {
    ($(#[$meta:meta])* $name:ident { $($(#[$variant_meta:meta])* $variant:ident = $word:literal),+ $(,)? }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum $name { $($(#[$variant_meta])* $variant),+ }

        impl $name {
            /// Every value, in the order of their documentation.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The spelling in files, on the command line and in reports.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $word),+ }
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.name())
            }
        }

        impl FromStr for $name {
            type Err = String;

            fn from_str(text: &str) -> Result<Self, String> {
                match text {
                    $($word => Ok(Self::$variant),)+
                    _ => Err(unknown_word(text, &[$($word),+])),
                }
            }
        }

        impl crate::key::Value for $name {
            const KIND: crate::key::Kind = crate::key::Kind::Words(|| vec![$($word),+]);

            fn presence(&self) -> crate::key::Presence {
                crate::key::Presence::Word(self.name())
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(self.name())
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
            }
        }
    };
}

keywords! {
    /// What time is.
    Mode {
        /// The machine's clock: a late torque is late in the physics too.
        Realtime = "realtime",
        /// Virtual time: every tick waits for every member, and runs are bit-identical.
        Lockstep = "lockstep",
    }
}

keywords! {
    /// How the plant and the active controller wait.
    Wakeup {
        /// A spin up to the deadline, then the doorbell.
        Hybrid = "hybrid",
        /// The doorbell alone.
        Block = "block",
        /// A spin alone: lowest latency, one whole core.
        Spin = "spin",
        /// The transport's own events.
        Event = "event",
    }
}

keywords! {
    /// The shapes of a reference motion.
    ReferenceKind {
        /// One sine a link; the paper's.
        Sine = "sine",
        /// A sum of sines.
        MultiSine = "multi-sine",
        /// Point to point by a polynomial of the fifth degree, at rest before and after.
        Quintic = "quintic",
        /// A sine whose frequency rises.
        Chirp = "chirp",
        /// A circle of the tip.
        Circle = "circle",
        /// A C² spline through the points of a CSV file.
        Waypoints = "waypoints",
    }
}

keywords! {
    /// The shapes of a disturbance torque.
    DisturbanceKind {
        /// The same torque at all times.
        Constant = "constant",
        /// A sine.
        Sine = "sine",
        /// Nothing, then a constant torque.
        Step = "step",
        /// Band-limited noise.
        Noise = "noise",
    }
}

keywords! {
    /// The processes of a group that a scenario can name.
    Role {
        /// Publishes setpoints.
        Reference = "reference",
        /// Answers states with torques.
        Controller = "controller",
        /// Integrates the chain, and decides whose torque it applies.
        Plant = "plant",
        /// Watches.
        Monitor = "monitor",
    }
}

keywords! {
    /// What the supervisor does when a role dies.
    Restart {
        /// Starts it again after the back-off; a controller comes back as a standby.
        Restart = "restart",
        /// Goes on without it.
        Ignore = "ignore",
        /// Ends the group with its report.
        End = "end",
    }
}

keywords! {
    /// The kinds of injected faults.
    FaultKind {
        /// The process is killed.
        Kill = "kill",
        /// The process stops answering without dying.
        Hang = "hang",
        /// The sample is published later.
        Delay = "delay",
        /// The sample is not published.
        Drop = "drop",
        /// The values are not numbers.
        Nan = "nan",
        /// A torque is added to one joint.
        Glitch = "glitch",
        /// The sample is published twice.
        Duplicate = "duplicate",
        /// The sample is published after its successor.
        Reorder = "reorder",
        /// The sample is published beyond its grace deadline.
        Late = "late",
        /// The last setpoint is repeated.
        StaleSetpoint = "stale-setpoint",
        /// The role's stamps jump.
        ClockStep = "clock-step",
        /// A stranger publishes beside the role.
        Rogue = "rogue",
    }
}

keywords! {
    /// How the delays of a fault are spread.
    Distribution {
        /// Always `delay`.
        Constant = "constant",
        /// Uniform between `delay` and `delay_max`.
        Uniform = "uniform",
        /// Heavy tail from `delay` with exponent `shape`, cut at `delay_max`.
        Pareto = "pareto",
    }
}
