//! The product itself: a whole process group at 1 kHz, and the round trips that it recorded. So a bench that measures the loop
//! can't drift away from the loop.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};

use anyhow::{Context, Result, anyhow};
use loopbound_scenario::Wakeup;

/// Ticks at the start of each run that do not count.
const WARM_UP: u64 = 100;

/// A block of the product that is asked for.
#[derive(Clone, Copy, Debug)]
struct Order {
    mode: Wakeup,
    count: u64,
    ordinary: bool,
}

/// Runs the product from a thread of its own: one that began before this process became real-time, since a child inherits the
/// core and the priority of the thread that starts it.
pub(crate) struct Product {
    orders: Sender<Order>,
    blocks: Receiver<Result<Vec<u64>>>,
}

impl Product {
    /// To be called before this process asks for real time.
    pub(crate) fn start() -> Self {
        let (orders, to_do) = channel::<Order>();
        let (done, blocks) = channel();
        std::thread::spawn(move || {
            for order in to_do {
                if done.send(run(order)).is_err() {
                    return;
                }
            }
        });
        Self { orders, blocks }
    }

    /// The round trips of about `count` ticks, ns.
    pub(crate) fn block(&self, mode: Wakeup, count: u64, ordinary: bool) -> Result<Vec<u64>> {
        self.orders.send(Order { mode, count, ordinary }).context("the thread that runs the product has ended")?;
        self.blocks.recv().context("the thread that runs the product has ended")?
    }
}

fn run(order: Order) -> Result<Vec<u64>> {
    let folder = tempfile::tempdir()?;
    let mut command = Command::new(env!("CARGO_BIN_EXE_loopbound"));
    command
        .args(["run", "--quiet", "--rate", "1kHz", "--wakeup", order.mode.name(), "--out"])
        .arg(folder.path().join("run"));
    command.args(["--duration", &format!("{}ms", order.count + WARM_UP)]);
    if order.ordinary {
        command.args([
            "--set",
            "realtime.priority=0",
            "--set",
            "realtime.lock_memory=false",
            "--set",
            "realtime.dma_latency=false",
        ]);
    }
    // Whatever became of its bound: here its latencies count.
    let status = command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .context("starting loopbound")?;
    let block = round_trips(&folder.path().join("run/samples.csv"));
    block.with_context(|| format!("loopbound run --wakeup {}, which ended with {status}", order.mode))
}

fn round_trips(file: &Path) -> Result<Vec<u64>> {
    let text = std::fs::read_to_string(file)?;
    let mut lines = text.lines();
    let header = lines.next().context("samples.csv is empty")?;
    let column =
        header.split(',').position(|name| name == "round_trip_ns").context("samples.csv has no round_trip_ns")?;
    let mut block = Vec::new();
    for line in lines.skip(usize::try_from(WARM_UP)?) {
        // Empty where no torque was accepted.
        if let Some(field) = line.split(',').nth(column).filter(|field| !field.is_empty()) {
            block.push(field.parse()?);
        }
    }
    if block.is_empty() { Err(anyhow!("no tick was answered")) } else { Ok(block) }
}
