//! Options that several subcommands share.

use std::path::PathBuf;

use clap::Args;
use loopbound_model::law::LawKind;
use loopbound_model::quote;
use loopbound_scenario::system;
use loopbound_scenario::{Mode, Scenario, Wakeup, parse_duration, parse_rate};
use loopbound_shared::say;

use crate::supervise::prepare;

/// For commands whose only choice is the form of their output.
#[derive(Debug, Args)]
pub struct JsonArgs {
    /// Print one JSON document and nothing else.
    #[arg(long)]
    pub json: bool,
}

/// A scenario and what the command line changes in it; shared by all commands that take one.
#[derive(Debug, Default, Args)]
pub struct ScenarioArgs {
    /// Scenario file (TOML); default the paper's case.
    pub scenario: Option<PathBuf>,
    /// Length of the run, such as 10s.
    #[arg(long, value_parser = checked::<u64, _>(parse_duration), value_name = "TIME")]
    pub duration: Option<String>,
    /// Ticks per second, such as 1kHz.
    #[arg(long, value_parser = checked::<f64, _>(parse_rate), value_name = "RATE")]
    pub rate: Option<String>,
    /// realtime, or lockstep for virtual time.
    #[arg(long, value_parser = word::<Mode>, value_name = "MODE")]
    pub mode: Option<Mode>,
    /// Control law: robust, robust-ff, ctc or pd+g.
    #[arg(long, value_parser = word::<LawKind>, value_name = "LAW")]
    pub law: Option<LawKind>,
    /// How the loop waits: hybrid, block, spin or event.
    #[arg(long, value_parser = word::<Wakeup>, value_name = "HOW")]
    pub wakeup: Option<Wakeup>,
    /// Set any key of the scenario, such as plant.gravity=1.62; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

/// Keeps the text, which goes into the scenario as it is, but refuses it here where the option can be named.
fn checked<T: 'static, E: ToString + 'static>(
    parse: fn(&str) -> Result<T, E>,
) -> impl Fn(&str) -> Result<String, String> + Clone + Send + Sync + 'static {
    move |text| parse(text).map(|_| text.to_owned()).map_err(|e| e.to_string())
}

pub(crate) fn word<T: std::str::FromStr<Err: ToString>>(text: &str) -> Result<T, String> {
    text.parse().map_err(|e: T::Err| e.to_string())
}

impl ScenarioArgs {
    /// The options as settings of scenario keys, in the order in which they apply: `--set` has the last word.
    #[must_use]
    pub fn settings(&self) -> Vec<String> {
        let mut settings = Vec::new();
        let mut add = |key: &str, value: Option<String>| settings.extend(value.map(|v| format!("{key}={v}")));
        add("loop.duration", self.duration.clone());
        add("loop.rate", self.rate.clone());
        add("loop.mode", self.mode.map(|m| m.to_string()));
        add("loop.wakeup", self.wakeup.map(|w| w.to_string()));
        add("controller.law", self.law.map(|l| l.to_string()));
        settings.extend(self.set.iter().cloned());
        settings
    }

    /// The scenario that is meant.
    ///
    /// # Errors
    /// If the file can't be read, or a key or value is refused.
    pub fn load(&self) -> anyhow::Result<Scenario> {
        Ok(Scenario::read(self.scenario.as_deref(), &self.settings())?.0)
    }

    /// The same, if all that it describes can be built; says what is probably not what was meant.
    ///
    /// # Errors
    /// Those of [`Self::load`], and whatever would keep a process of the scenario from starting.
    pub fn load_system(&self, quiet: bool) -> anyhow::Result<Scenario> {
        let (scenario, origin) = Scenario::read(self.scenario.as_deref(), &self.settings())?;
        prepare::system_of(&scenario).map_err(|error| origin.locate(error))?;
        for line in if quiet { Vec::new() } else { system::remarks(&scenario)? } {
            say::err!("loopbound: {}", quote::lines(&line));
        }
        Ok(scenario)
    }
}
