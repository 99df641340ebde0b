//! What an exchange costs, and what this project adds to it: `cargo bench --bench exchange`.
//!
//! Two processes, the plant's end (this one) and the echo (this executable again), exchange a state for a torque by
//! each mechanism in turn: blocks of all of them, round after round, so that whatever disturbs the machine falls on
//! all alike. Each mechanism is compared with its baseline within a round. Then the kernels: the mathematics of a tick.
//!
//! `--quick` for a look, `--paced` for a 1 kHz loop instead of back to back, `--ordinary` without asking for real
//! time, `--json` for machines.

mod echo_end;
mod host;
mod kernels;
mod mechanism;
mod plant_end;
mod product;
mod raw;
mod report;
mod statistics;
mod transport;

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result};
use clap::Parser;
use loopbound_scenario::Wakeup;
use loopbound_shared::clock;
use loopbound_shared::group::Group;
use loopbound_shared::realtime::{self, ProcessHandle, Request};
use loopbound_shared::sample::Setpoint;
use loopbound_shared::say;

use crate::mechanism::Mechanism;
use crate::plant_end::PlantEnd;
use crate::product::Product;
use crate::raw::Page;
use crate::report::Report;
use crate::statistics::Blocks;

/// Links of the chain in the worked exchange: the paper's triple link.
const LINKS: usize = 3;
/// An answer that takes longer will not come. Below the limit after which the kernel ends a real-time process that
/// never sleeps.
const SILENCE_NS: u64 = 300_000_000;
/// Looks between two looks at the clock in the spinning baselines, which need it only to notice silence.
const SPIN_LOOKS: u32 = 256;
/// The wake-up modes, each with its own waiters and ringers.
const MODES: [Wakeup; 4] = [Wakeup::Hybrid, Wakeup::Spin, Wakeup::Block, Wakeup::Event];
/// The mode of the worked exchange.
const WORKED_IN: Wakeup = Wakeup::Hybrid;

/// Compares this project's exchange with what it is built on, and times its kernels.
#[derive(Parser, Debug)]
struct Arguments {
    /// Few exchanges: a look, not a result.
    #[arg(long)]
    quick: bool,
    /// At 1 kHz instead of back to back.
    #[arg(long)]
    paced: bool,
    /// Ask for no privilege: ordinary scheduler, idle cores may halt.
    #[arg(long)]
    ordinary: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Exchanges of each mechanism [default: 100000; 2000 with --quick; 10000 with --paced].
    #[arg(long)]
    n: Option<u64>,
    /// Rounds that they are spread over.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(6..=1000))]
    rounds: u64,
    /// Skip the exchanges.
    #[arg(long)]
    kernels_only: bool,
    /// Cargo passes it.
    #[arg(long, hide = true)]
    bench: bool,
    /// Be the echo of this group.
    #[arg(long, hide = true, requires = "parent")]
    echo: Option<String>,
    /// Who started the echo.
    #[arg(long, hide = true)]
    parent: Option<u32>,
}

impl Arguments {
    fn exchanges(&self) -> u64 {
        self.n.unwrap_or(match (self.quick, self.paced) {
            (true, _) => 2000,
            (_, true) => 10_000,
            _ => 100_000,
        })
    }

    const fn period_ns(&self) -> u64 {
        if self.paced { 1_000_000 } else { 0 }
    }

    fn request(&self, cores: &[usize], place: usize) -> Request {
        let core = cores.get(place).copied().filter(|_| cores.len() > 1);
        if self.ordinary {
            Request { core, ..Request::default() }
        } else {
            Request { priority: 80, core, lock_memory: true, dma_latency: true }
        }
    }
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say::err!("exchange: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    let cores = host::allowed_cores();
    // Asked before any end binds itself to one core.
    ALONE.get_or_init(|| cores.len() < 2);
    if let (Some(group), Some(parent)) = (&arguments.echo, arguments.parent) {
        return echo_end::run(group, parent, &arguments.request(&cores, 1));
    }
    let mut report = Report::new(host::describe());
    if !arguments.kernels_only {
        exchanges(arguments, &cores, &mut report)?;
    }
    if !arguments.paced {
        report.kernels = kernels::measure(arguments.quick)?;
    }
    report.print(arguments.json)
}

fn exchanges(arguments: &Arguments, cores: &[usize], report: &mut Report) -> Result<()> {
    let group = Group::create(&format!("bench-{}", std::process::id()))?;
    let product = Product::start();
    let mut plant = PlantEnd::open(&group)?;
    let mut echo = Echo::start(&group, arguments)?;
    let mut entered = realtime::enter(&arguments.request(cores, 0));
    entered.populate_shared(&[group.prefix().as_str()]);
    report.privileges = [format!("plant {}", entered.privileges()), format!("echo {}", echo.privileges()?)];
    let mechanisms: &[Mechanism] = if arguments.paced { &Mechanism::PACED } else { &Mechanism::ALL };
    let mut measured: Vec<(Mechanism, Blocks)> = mechanisms.iter().map(|m| (*m, Blocks::new())).collect();
    let block = arguments.exchanges().div_ceil(arguments.rounds);
    for _ in 0..arguments.rounds {
        for (mechanism, blocks) in &mut measured {
            blocks.push(match mechanism {
                Mechanism::Product(mode) => product.block(*mode, block, arguments.ordinary)?,
                _ => plant.run_block(*mechanism, block, arguments.period_ns())?,
            });
        }
    }
    plant.dismiss();
    echo.child.wait()?;
    report.rows = statistics::rows(&measured, arguments.paced);
    report.period_ns = arguments.period_ns();
    report.rounds = arguments.rounds;
    Ok(())
}

/// The echo process; ended with this value, however this value ends.
struct Echo {
    child: Child,
}

impl Echo {
    fn start(group: &Group, arguments: &Arguments) -> Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["--echo", group.name(), "--parent", &std::process::id().to_string()]);
        if arguments.ordinary {
            command.arg("--ordinary");
        }
        let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().context("starting the echo")?;
        watch(ProcessHandle::open(child.id())?, Page::open(&group.file("raw"))?);
        Ok(Self { child })
    }

    /// What it says once it is ready.
    fn privileges(&mut self) -> Result<String> {
        let mut line = String::new();
        let output = self.child.stdout.take().context("the echo's output")?;
        BufReader::new(output).read_line(&mut line)?;
        anyhow::ensure!(!line.is_empty(), "the echo process has ended before it was ready");
        Ok(line.trim_end().to_owned())
    }
}

impl Drop for Echo {
    fn drop(&mut self) {
        // It may have ended by itself; both fail then, and nothing is left either way.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The raw futex has no timeout, which would cost it a timer: if the echo dies, this ends the plant's wait instead.
fn watch(echo: ProcessHandle, page: Page) {
    std::thread::spawn(move || {
        while !echo.wait_end(1_000_000_000).unwrap_or(true) {}
        page.orders.abandoned.store(1, Ordering::Relaxed);
        // Again and again: a wake-up between the look at the mark and the sleep would be lost.
        for _ in 0..20 {
            page.torques.wake();
            clock::sleep_ns(50_000_000);
        }
    });
}

static ALONE: OnceLock<bool> = OnceLock::new();

/// Between two looks of a spinner; with one core the other end has to be let in.
fn pause() {
    if *ALONE.get_or_init(|| false) {
        rustix::thread::sched_yield();
    } else {
        clock::spin_hint();
    }
}

/// Waits by iceoryx2's own events; none after a long silence.
fn by_events<Out: transport::Payload, In: transport::Payload>(end: &transport::End<Out, In>) -> Option<In> {
    let until_ns = clock::now_ns() + SILENCE_NS;
    loop {
        if let Some(found) = end.take() {
            return Some(found);
        }
        let now_ns = clock::now_ns();
        if now_ns >= until_ns {
            return None;
        }
        end.sleep(until_ns - now_ns);
    }
}

/// Which of the ends' pairs of waiter and ringer belongs to a mode.
fn place_of(mode: Wakeup) -> usize {
    MODES.iter().position(|m| *m == mode).unwrap_or(0)
}

/// Rest at the origin, as setpoint of a tick.
fn setpoint(tick: u64) -> Setpoint {
    Setpoint { tick, links: 3, ..Setpoint::zeroed() }
}
