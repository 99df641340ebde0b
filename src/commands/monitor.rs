//! `loopbound monitor`: watches a running group, from the terminal or as the launcher's own monitor.

use std::path::PathBuf;

use clap::Args;
use loopbound_monitor::live::{Address, Origin};
use loopbound_monitor::tui::Left;
use loopbound_scenario::parse_duration;

use super::roles::begin;
use crate::exit::Exit;
use crate::supervise::needs;

/// `loopbound monitor`.
#[derive(Debug, Args)]
pub struct MonitorOptions {
    /// Name of the group (see `loopbound ps`).
    #[arg(long)]
    pub group: String,
    /// Folder for summary.json, samples.csv, histograms and events.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print one JSON document instead of the report.
    #[arg(long)]
    pub json: bool,
    /// Draw the group on the terminal instead: chain, V and its bounds, latencies, events.
    #[arg(long, conflicts_with_all = ["out", "json"])]
    pub tui: bool,
    /// Serve the group live over the Foxglove WebSocket protocol at HOST:PORT, HOST or PORT; default host 127.0.0.1,
    /// default port 8765.
    #[arg(long, value_name = "ADDR", conflicts_with = "tui")]
    pub foxglove: Option<Address>,
    /// Let web pages of this origin look too, such as `https://viewer.example:8080`. Those of Foxglove and of this machine may
    /// anyway.
    #[arg(long = "foxglove-origin", value_name = "ORIGIN", requires = "foxglove")]
    pub foxglove_origins: Vec<Origin>,
    /// How long to watch (such as 5s); default until the group ends.
    #[arg(long, value_parser = parse_duration, value_name = "TIME")]
    pub duration: Option<u64>,
    /// Errors alone, no notes.
    #[arg(long, hide = true)]
    pub quiet: bool,
    /// The launcher's own monitor: it grants credit in lockstep and leaves its summary to the launcher.
    #[arg(long, hide = true)]
    pub managed: bool,
    /// Id within the group.
    #[arg(long, hide = true, default_value_t = 1)]
    pub id: u32,
    /// The scenario; default the group's.
    #[arg(long, hide = true)]
    pub scenario: Option<PathBuf>,
    /// The launcher.
    #[arg(long, hide = true)]
    pub parent: Option<u32>,
}

/// `loopbound monitor`: attached by a user, or managed by the launcher.
///
/// # Errors
/// The monitor's, or the system's.
pub fn run(args: MonitorOptions) -> anyhow::Result<Exit> {
    let stop = begin(args.parent)?;
    if !args.managed {
        needs::check_descriptors(0)?;
    }
    let tui = args.tui;
    let args = loopbound_monitor::MonitorArgs {
        group: args.group,
        id: args.id,
        scenario: args.scenario,
        parent: args.parent,
        out: args.out,
        json: args.json,
        quiet: args.quiet,
        managed: args.managed,
        duration_ns: args.duration,
        foxglove: args.foxglove,
        foxglove_origins: args.foxglove_origins,
    };
    if tui {
        let left = loopbound_monitor::tui::run(&args, stop)?;
        return Ok(if left == Left::Interrupted { Exit::Interrupted } else { Exit::Held });
    }
    let outcome = loopbound_monitor::run(&args, stop)?;
    // The launcher looks at the recording of its own monitor itself.
    let whole = outcome.summary.recording.is_none_or(|recording| recording.whole);
    Ok(if whole || args.managed { Exit::Held } else { Exit::RoleDied })
}
