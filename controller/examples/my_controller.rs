//! A controller of your own: a PD law with its own gains, as a process that a running group can be switched to.
//!
//! ```text
//! cargo build --release -p loopbound-controller --example my_controller
//! loopbound run --group demo --duration 60s &
//! loopbound swap --group demo --exe target/release/examples/my_controller --blend 50ms
//! ```
//!
//! Everything but the law is the frame's: joining the group, real time, waiting for states, setpoints, stamps. It makes
//! no claim to be a built-in law, so the bound is not checked while it is in charge, and the gate looks at its timing,
//! its limits and the torque step alone.

use loopbound_controller::{Controller, Input, parse_args, serve};
use loopbound_shared::role::RoleError;

/// Stiffness, N·m/rad.
const K_P: f64 = 250.0;
/// Damping, N·m·s/rad.
const K_D: f64 = 50.0;

struct Pd;

impl Controller for Pd {
    fn name(&self) -> &str {
        "my pd"
    }

    // Called once a tick in real time: no allocation, no lock, no input or output in here.
    fn torque(&mut self, input: &Input<'_>, tau: &mut [f64]) {
        for (i, tau) in tau.iter_mut().enumerate() {
            *tau = K_P * (input.q_d[i] - input.q[i]) + K_D * (input.v_d[i] - input.v[i]);
        }
    }
}

fn main() -> Result<(), RoleError> {
    serve(Pd, &parse_args(std::env::args())?)
}
