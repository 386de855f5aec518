//! `gelstereo-host`: see `gelstereo-host --help`.
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout))]

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
