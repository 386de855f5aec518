//! `gelstereo-host`: see `gelstereo-host --help`.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
