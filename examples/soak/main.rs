//! Wears groups out: hundreds of swaps and kills on real processes, and counts what it cost.
//!
//! ```text
//! cargo run --release --example soak -- --swaps 500 --kills 300 --groups 300
//! cargo run --release --example soak -- --swaps 0 --kills 0 --groups 0 --load 0 --signals 500
//! ```
//!
//! It is its own `loopbound`: called with a subcommand it behaves as one, so that nothing else need be built. It ends
//! with code 1 if anything was left behind, hung, or was not as it should be; ticks that the host cost are only counted.

mod barrage;
mod groups;
mod kills;
mod live;
mod remains;
mod signals;
mod swaps;
mod trace;

use std::process::ExitCode;

use clap::Parser;
use loopbound_shared::say;

/// Hundreds of swaps and kills, and what they cost.
#[derive(Debug, Parser)]
struct Args {
    /// Swaps between robust, robust-ff and ctc in one group at 1 kHz.
    #[arg(long, default_value_t = 12)]
    swaps: u32,
    /// Kills of the active controller of one group with a standby.
    #[arg(long, default_value_t = 6)]
    kills: u32,
    /// Groups in which random roles are killed, one kill a group.
    #[arg(long, default_value_t = 6)]
    groups: u32,
    /// Groups of which random processes get random signals at random instants, many in the first 40 ms.
    #[arg(long, default_value_t = 6)]
    signals: u64,
    /// Number of the first of these groups: to see one of them again.
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Threads that compute for nothing at the ordinary priority meanwhile.
    #[arg(long, default_value_t = 2)]
    load: u32,
    /// The sequence of victims, instants and signals.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

const SUBCOMMANDS: [&str; 8] = ["run", "swap", "clean", "keeper", "plant", "controller", "reference", "monitor"];

fn main() -> ExitCode {
    if std::env::args().nth(1).is_some_and(|first| SUBCOMMANDS.contains(&first.as_str())) {
        return loopbound::args::main();
    }
    match soak(&Args::parse()) {
        Ok(0) => ExitCode::SUCCESS,
        Ok(faults) => {
            say::out!("{faults} faults");
            ExitCode::FAILURE
        }
        Err(error) => {
            say::err!("soak: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Returns how many things were not as they should be.
fn soak(args: &Args) -> anyhow::Result<u32> {
    let _load: Vec<live::Load> = (0..args.load).map(|_| live::Load::start()).collect::<Result<_, _>>()?;
    let mut faults = 0;
    if args.swaps > 0 {
        faults += swaps::run(args.swaps)?;
    }
    if args.kills > 0 {
        faults += kills::run(args.kills)?;
    }
    if args.groups > 0 {
        faults += groups::run(args.groups, args.seed)?;
    }
    if args.signals > 0 {
        faults += signals::run(args.signals, args.first, args.seed)?;
    }
    Ok(faults)
}
