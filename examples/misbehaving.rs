//! A controller that does one thing wrong in every 50th tick, for `attribution`: `MISBEHAVE=overrun` computes for 700 µs,
//! `MISBEHAVE=page_fault` touches memory that it has never touched. When it did is in the file `MISBEHAVE_LOG` at the end.

use std::sync::{Arc, Mutex};

use loopbound_controller::{Controller, Input, parse_args, serve};
use loopbound_shared::clock;

/// Pages touched in one such tick: some 250 ns each at least, so their faults make the tick late.
const PAGES: usize = 1_024;
const PAGE_BYTES: usize = 4_096;
/// Above the largest size that the allocator keeps for reuse: a fresh mapping every time.
const BYTES: usize = 48 << 20;
/// Ticks between two.
const EVERY: u64 = 50;
const OVERRUN_NS: u64 = 700_000;

/// Strikes that are remembered: there is room from the start, so that the list makes no fault of its own.
const STRIKES_MAX: usize = 100_000;

struct Misbehaving {
    faults: bool,
    struck: Arc<Mutex<Vec<(u64, u64)>>>,
}

impl Controller for Misbehaving {
    fn name(&self) -> &str {
        "misbehaving"
    }

    fn torque(&mut self, input: &Input<'_>, tau: &mut [f64]) {
        let strikes = input.tick.is_multiple_of(EVERY) && input.tick > 0;
        let from_ns = clock::now_ns();
        if strikes && self.faults {
            let mut memory = vec![0u8; BYTES];
            memory.iter_mut().step_by(PAGE_BYTES).take(PAGES).for_each(|byte| *byte = 1);
            std::hint::black_box(&memory);
        } else if strikes {
            let until_ns = clock::now_ns() + OVERRUN_NS;
            while clock::now_ns() < until_ns {
                std::hint::spin_loop();
            }
        }
        if strikes && let Ok(mut struck) = self.struck.lock() {
            struck.push((from_ns, clock::now_ns()));
        }
        for (link, torque) in tau.iter_mut().enumerate() {
            *torque = 40.0 * (input.q_d[link] - input.q[link]) + 12.0 * (input.v_d[link] - input.v[link]);
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = parse_args(std::env::args())?;
    let faults = std::env::var("MISBEHAVE").is_ok_and(|what| what == "page_fault");
    let struck = Arc::new(Mutex::new(Vec::with_capacity(STRIKES_MAX)));
    serve(Misbehaving { faults, struck: Arc::clone(&struck) }, &args)?;
    if let (Some(path), Ok(struck)) = (std::env::var_os("MISBEHAVE_LOG"), struck.lock()) {
        let lines: String = struck.iter().map(|(from_ns, to_ns)| format!("{from_ns} {to_ns}\n")).collect();
        std::fs::write(path, lines)?;
    }
    Ok(())
}
