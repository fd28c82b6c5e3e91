//! The `ubbmap` program: see `ubbmap --help`.

fn main() -> std::process::ExitCode {
    ubbmap::cli::run()
}
