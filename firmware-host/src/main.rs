//! `gelstereo-host`: see `gelstereo-host --help`.
#![allow(clippy::print_stdout)]

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
