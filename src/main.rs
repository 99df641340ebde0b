//! The `loopbound` executable: all of it is in the library, so that tests and examples reach the same code.

use std::process::ExitCode;

fn main() -> ExitCode {
    loopbound::args::main()
}
