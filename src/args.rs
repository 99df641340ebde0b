//! The command line: what may be written, and which module does it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};
use clap_complete::Shell;
use loopbound_model::quote;
use loopbound_shared::say;

use crate::commands::{
    bound, check, clean, compare, doctor, fault, model, monitor, options, pages, ps, replay, report, roles, run,
    scenario, study, swap,
};
use crate::exit::{Exit, one_line};
use crate::signals;
use crate::supervise::{keeper, needs};

/// kHz control loops split across processes over shared memory: latency measured to the nanosecond, and a Lyapunov
/// bound checked live.
#[derive(Debug, Parser)]
#[command(
    name = "loopbound",
    version,
    max_term_width = 100,
    after_help = "\
Exit codes:
  0    held, or passed
  1    an expectation failed, the loop diverged, or the bound was violated and the age of the torque is not the cause
  2    usage or scenario
  3    inconclusive
  4    a swap was refused or rolled back, or a fault refused
  5    a role died and was not recovered, or the run or its recording is incomplete
  70   internal
  130  interrupted
  143  terminated

Environment:
  LOOPBOUND_RUNTIME_DIR  absolute path of the directory that running groups are kept in; it must be yours and closed to
                         other users (mode 0700), and is made if it is not there. Default: /dev/shm/loopbound-UID"
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start a process group, supervise it to its end, and report on one screen.
    #[command(after_help = "\
Examples:
  loopbound run                                        the paper's case, 1 kHz, 10 s
  loopbound run --rate 2kHz --law ctc --duration 30s   another law, faster, longer
  loopbound run --set plant.mass_error=0.1             any key of the scenario
  loopbound run scenarios/ci.toml --json --out results one JSON document, and all files of the run
  loopbound run --tui --duration 60s                   live on the terminal
  loopbound run --foxglove 8765 --duration 60s         live in Foxglove, at ws://127.0.0.1:8765
  loopbound run --mode lockstep                        virtual time, as fast as the machine allows")]
    Run(run::RunArgs),
    /// Watch a running group; attach and detach at any time.
    #[command(after_help = "\
Examples:
  loopbound monitor --group lb-4711                    until the group ends or Ctrl-C, then a report
  loopbound monitor --group lb-4711 --duration 5s --json
  loopbound monitor --group lb-4711 --out results
  loopbound monitor --group lb-4711 --tui              live on the terminal
  loopbound monitor --group lb-4711 --foxglove 8765    live in Foxglove, at ws://127.0.0.1:8765
  loopbound monitor --group lb-4711 --foxglove 0.0.0.0:8765   the same, for other machines too")]
    Monitor(monitor::MonitorOptions),
    /// Replace the active controller of a running group, without a missed tick.
    #[command(after_help = "\
Examples:
  loopbound swap --group lb-4711 --law ctc             as soon as the gate passes
  loopbound swap --group lb-4711 --law robust-ff --blend 20ms
  loopbound swap --group lb-4711 --exe target/release/examples/my_controller --at-tick 5000
  loopbound swap --group lb-4711 --to 2 --json         to the standby with number 2
Exit code 4: refused or rolled back; the old controller is still in charge.")]
    Swap(swap::SwapArgs),
    /// Inject a fault into a controller of a running group.
    #[command(after_help = "\
Examples:
  loopbound fault --group lb-4711 delay                every torque too late, for 100 ms
  loopbound fault --group lb-4711 delay --delay 200us --for 2s
  loopbound fault --group lb-4711 hang --for 20ms      stopped, and let go on (SIGSTOP, SIGCONT)
  loopbound fault --group lb-4711 kill --controller 2  kill -9
Kinds: delay, drop (no torque), nan (torques that are no numbers), glitch (a torque added to the first link), kill, hang. What
follows is put down to `injected fault`.
Exit code 4: refused.")]
    Fault(fault::FaultArgs),
    /// Feed a recorded run to the same code again: identical to the bit, or what if.
    #[command(after_help = "\
Examples:
  loopbound replay results                             states, torques, V and verdict again, bit for bit
  loopbound replay results --law ctc                   what if another law had given the torques
  loopbound replay results --set plant.mass_error=0.2 --json
Exit codes: 0 identical; 1 it differs; 2 unreadable, or of another build; 3 records are missing, what is there agrees; 5 the
recording is not whole, what is there is shown.")]
    Replay(replay::ReplayArgs),
    /// Write report.html of a recorded run again, or of two runs side by side.
    #[command(after_help = "\
Examples:
  loopbound report results                             results/report.html
  loopbound report before after --out compared.html    two runs side by side")]
    Report(report::ReportArgs),
    /// List the running groups of this user and their processes.
    #[command(after_help = "Examples:\n  loopbound ps\n  loopbound ps --json")]
    Ps(options::JsonArgs),
    /// Examine this machine: what will delay a loop here, what it costs, and the command that fixes it.
    #[command(after_help = "Examples:\n  loopbound doctor\n  loopbound doctor --json")]
    Doctor(options::JsonArgs),
    /// Remove what killed groups left in shared memory; running groups are not touched.
    #[command(
        after_help = "Example:\n  loopbound clean\nIt looks in /dev/shm/loopbound-UID, or where LOOPBOUND_RUNTIME_DIR says, and removes only what loopbound made there."
    )]
    Clean,
    /// Judge a recorded run by expectations, again or for the first time.
    #[command(after_help = "\
Examples:
  loopbound check results                              by the expectations of its own scenario
  loopbound check results --expect expect.toml --junit junit.xml
Exit codes: 0 passed, 1 failed, 3 inconclusive, 5 the recording is not whole.")]
    Check(check::CheckArgs),
    /// Compare two recorded runs: the ratio of each quantile with its confidence interval.
    #[command(after_help = "Examples:\n  loopbound compare before after\n  loopbound compare before after --json")]
    Compare(compare::CompareArgs),
    /// Print the certificate of a scenario without running it.
    #[command(after_help = "\
Examples:
  loopbound bound
  loopbound bound --law ctc --set controller.uncertainty.mass=0.1
  loopbound bound --latency 100us                      what that latency leaves, and gains that prove more
  loopbound bound scenarios/mismatch.toml --json")]
    Bound(bound::BoundArgs),
    /// Run many cases of one question, and write tables, pictures and conclusions.
    #[command(after_help = "\
Examples:
  loopbound study paper                                the paper's figures and claims
  loopbound study paper --quick --links 1,2,3,5,7
  loopbound study delay --links 1,3,7 --out study      the stability boundary, measured and predicted
  loopbound study rate --law robust-ff
  loopbound study load --quick                         which setting for this machine, measured")]
    Study(study::StudyArgs),
    /// Print every key of a scenario with its default and its meaning, or the JSON schema for editors.
    #[command(after_help = "\
Examples:
  loopbound scenario > my.toml                         a file to begin with
  loopbound scenario --schema > scenario.schema.json   then, as the first line of a scenario: #:schema ./scenario.schema.json")]
    Scenario(scenario::KeysArgs),
    /// Answer each line of JSON with M, C, G and the acceleration at that state.
    #[command(after_help = "\
Example:
  echo '{\"q\":[0.3,-0.2,0.25],\"v\":[0,0,0],\"tau\":[0,0,0]}' | loopbound model
Keys of a line: q, v, tau, and optionally chain {mass, length, inertia, gravity} or {a, b}; v and tau default to zero.
A line that can't be answered gets {\"error\": …} on its own line, and the exit code is 2.")]
    Model(model::ModelArgs),
    /// Print the completions of a shell.
    #[command(
        after_help = "Example:\n  loopbound completions bash > ~/.local/share/bash-completion/completions/loopbound"
    )]
    Completions {
        /// Which shell.
        shell: Shell,
    },
    /// Print the manual page, or write those of all commands to a folder.
    #[command(after_help = "Examples:\n  loopbound man | man -l -\n  loopbound man --out ~/.local/share/man/man1")]
    Man {
        /// Folder for loopbound.1, loopbound-run.1 …
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// The plant's role, started by `run`.
    #[command(hide = true)]
    Plant(roles::ChildArgs),
    /// A controller's role, started by `run`.
    #[command(hide = true)]
    Controller(roles::ChildArgs),
    /// The reference's role, started by `run`.
    #[command(hide = true)]
    Reference(roles::ChildArgs),
    /// Ends what is left of a run when its launcher has ended; started by `run`.
    #[command(hide = true)]
    Keeper(keeper::KeeperArgs),
}

/// Parses the command line, does it, and says how it went.
#[must_use]
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return not_parsed(&error).into(),
    };
    needs::raise_limits();
    signals::let_writes_fail();
    let printing = prints_its_result(&cli.command);
    let exit = dispatch(cli.command).unwrap_or_else(|error| {
        say::err!("loopbound: {}", quote::lines(&one_line(&error)));
        Exit::of(&error)
    });
    after_printing(exit, printing).into()
}

/// Help and version go to standard output with code 0, everything else to standard error.
fn not_parsed(error: &clap::Error) -> Exit {
    let text = error.render();
    if error.use_stderr() {
        // It quotes what was written, which must not command the terminal: then there are no colours either.
        let plain =
            |argument: &std::ffi::OsStr| quote::lines(&argument.to_string_lossy()) == argument.to_string_lossy();
        let colour = say::in_colour(say::err_to_terminal()) && std::env::args_os().all(|argument| plain(&argument));
        let text = if colour { text.ansi().to_string() } else { quote::lines(&text.to_string()) };
        say::err!("{}", text.trim_end_matches('\n'));
        return Exit::Usage;
    }
    let text = if say::in_colour(say::to_terminal()) { text.ansi().to_string() } else { text.to_string() };
    say::out!("{}", text.trim_end_matches('\n'));
    after_printing(Exit::Held, true)
}

/// Whether a command is of no use without what it prints. The others have done something that stands.
fn prints_its_result(command: &Command) -> bool {
    use Command::{Clean, Controller, Fault, Plant, Reference, Report, Run, Study, Swap};
    let acts = matches!(
        command,
        Run(_) | Swap(_) | Fault(_) | Study(_) | Report(_) | Clean | Plant(_) | Controller(_) | Reference(_)
    );
    !acts
}

/// The exit code, when a part of standard output was lost other than by its reader's leaving: a lost result is an error of
/// its own, a run's verdict stands. Either way a line says so.
fn after_printing(exit: Exit, prints_its_result: bool) -> Exit {
    let Some(error) = say::lost() else { return exit };
    say::err!("loopbound: standard output can't be written: {error}");
    if prints_its_result { Exit::Internal } else { exit }
}

fn dispatch(command: Command) -> anyhow::Result<Exit> {
    match command {
        Command::Run(args) => run::run(&args),
        Command::Monitor(args) => monitor::run(args),
        Command::Swap(args) => swap::run(&args),
        Command::Fault(args) => fault::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Ps(args) => ps::run(args.json),
        Command::Doctor(args) => doctor::run(args.json),
        Command::Clean => clean::run(),
        Command::Check(args) => check::check(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Bound(args) => bound::run(&args),
        Command::Scenario(args) => scenario::run(&args),
        Command::Model(args) => model::run(&args),
        Command::Study(args) => study::run(&args),
        Command::Completions { shell } => pages::completions(shell, &mut Cli::command()),
        Command::Man { out } => pages::manual(out.as_deref(), Cli::command()),
        Command::Plant(args) => roles::role(loopbound_plant::run, args.into_role()),
        Command::Controller(args) => {
            let law = args.law;
            roles::role(|role, stop| loopbound_controller::run(role, law, stop), args.into_role())
        }
        Command::Reference(args) => roles::role(loopbound_reference::run, args.into_role()),
        Command::Keeper(args) => keeper::run(&args),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<Cli, clap::Error> {
        Cli::try_parse_from(line.split_whitespace())
    }

    #[test]
    fn the_definition_is_consistent_and_every_visible_command_shows_an_example() {
        Cli::command().debug_assert();
        for command in Cli::command().get_subcommands().filter(|c| !c.is_hide_set()) {
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            assert!(help.contains("loopbound "), "{} has no example", command.get_name());
        }
    }

    #[test]
    fn what_can_not_be_parsed_ends_with_code_2_and_names_what_is_allowed() {
        for (line, named) in [
            ("loopbound run --rate 1", "--rate"),
            ("loopbound run --duration -1s", "unexpected"),
            ("loopbound run --duration 10", "--duration"),
            ("loopbound run --law robst", "robust"),
            ("loopbound run --mode fast", "lockstep"),
            ("loopbound frobnicate", "frobnicate"),
            ("loopbound monitor", "--group"),
        ] {
            let error = parse(line).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{line}");
            assert!(error.to_string().contains(named), "{line}: {error}");
        }
    }

    #[test]
    fn options_become_settings_and_set_has_the_last_word() {
        let cli = parse("loopbound run --set loop.rate=500Hz --rate 2kHz --mode lockstep --law pd+g").unwrap();
        let Command::Run(args) = cli.command else { panic!("not run") };
        let expected = ["loop.rate=2kHz", "loop.mode=lockstep", "controller.law=pd+g", "loop.rate=500Hz"];
        assert_eq!(args.scenario.settings(), expected);
    }

    #[test]
    fn a_role_is_started_as_the_launcher_writes_it() {
        let cli = parse("loopbound plant --group g --id 1 --scenario s.toml --parent 7").unwrap();
        let Command::Plant(args) = cli.command else { panic!("not plant") };
        let role = args.into_role();
        assert_eq!((role.group.as_str(), role.id, role.parent), ("g", 1, Some(7)));
    }
}
