//! What `strace` wrote down of a process: its calls to the system, each with where it began and ended.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

/// All calls that change files or what is known of them. Those that the replay does not know end it with an error where
/// they concern the files watched.
const CALLS: &str = "trace=open,openat,openat2,creat,close,dup,dup2,dup3,fcntl,lseek,write,pwrite64,writev,pwritev,\
    pwritev2,ftruncate,truncate,fallocate,copy_file_range,sendfile,splice,fsync,fdatasync,syncfs,sync,rename,\
    renameat,renameat2,link,linkat,symlink,symlinkat,unlink,unlinkat,mkdir,mkdirat,rmdir";

/// A call that came back without an error, or that the end of the process cut short.
#[derive(Debug)]
pub struct Call {
    /// The line at which it began.
    pub start: usize,
    /// The line at which it was done; beyond all lines when it was not.
    pub end: usize,
    pub name: String,
    pub arguments: Vec<String>,
    pub result: i64,
}

impl Call {
    pub fn number(&self, argument: usize) -> i64 {
        let text = &self.arguments[argument];
        text.parse().unwrap_or_else(|_| panic!("{}: {text:?} is no number", self.name))
    }

    /// The bytes of a quoted argument.
    pub fn bytes(&self, argument: usize) -> Vec<u8> {
        let text = &self.arguments[argument];
        let hex = text.strip_prefix('"').and_then(|text| text.strip_suffix('"'));
        let hex = hex.unwrap_or_else(|| panic!("{}: an argument is cut short", self.name)).as_bytes();
        let digit = |c: u8| char::from(c).to_digit(16).unwrap() as u8;
        hex.chunks_exact(4).map(|c| digit(c[2]) << 4 | digit(c[3])).collect()
    }

    pub fn path(&self, argument: usize) -> String {
        String::from_utf8(self.bytes(argument)).unwrap()
    }
}

/// Why no process can be watched here; `None` when one can.
pub fn obstacle() -> Option<String> {
    let mut tried = Command::new("strace");
    tried.args(["-f", "--seccomp-bpf", "-o", "/dev/null", "true"]).stdout(Stdio::null()).stderr(Stdio::null());
    match tried.status() {
        Ok(status) if status.success() => None,
        Ok(_) => Some("strace may not watch a process here".to_owned()),
        Err(_) => Some("strace is not installed".to_owned()),
    }
}

/// A program that is watched from its start to its end, and the file that tells of it.
pub fn watched(program: &Path, log: &Path) -> Command {
    let mut command = Command::new("strace");
    command.args(["-f", "--seccomp-bpf", "-xx", "-s", "4194304", "-e", CALLS, "-o"]).arg(log).arg(program);
    command
}

/// The calls in the order in which they ended, and the number of lines.
pub fn read(log: &Path) -> (Vec<Call>, usize) {
    let mut reader = BufReader::new(File::open(log).unwrap());
    let mut begun: Vec<(String, usize, String)> = Vec::new();
    let (mut calls, mut count, mut line) = (Vec::new(), 0, String::new());
    while reader.read_line(&mut line).unwrap() > 0 {
        let (process, text) = line.trim_end().split_once(' ').unwrap();
        let text = text.trim_start();
        if let Some(start) = text.strip_suffix(" <unfinished ...>") {
            begun.push((process.to_owned(), count, start.to_owned()));
        } else if let Some(resumed) = text.strip_prefix("<... ") {
            let at = begun.iter().position(|(of, ..)| of == process).unwrap();
            let (_, start, first) = begun.swap_remove(at);
            let rest = resumed.split_once(" resumed>").unwrap().1;
            if rest.ends_with(" = ?") {
                begun.push((process.to_owned(), start, first));
            } else {
                calls.extend(parse(&format!("{first}{rest}"), start, count));
            }
        } else {
            calls.extend(parse(text, count, count));
        }
        count += 1;
        line.clear();
    }
    // Threads go on until their process is gone: what they were at may be done or not.
    calls.extend(begun.into_iter().filter_map(|(_, start, first)| cut_short(&first, start)));
    (calls, count)
}

/// A write or a change of length that did not come back.
fn cut_short(first: &str, start: usize) -> Option<Call> {
    let first = first.trim_end().trim_end_matches(',');
    let length = match first.split_once('(')? {
        ("pwrite64", arguments) => arguments.split(", ").nth(2)?,
        ("ftruncate", _) => "0",
        (name, _) => panic!("the process ended in {name}"),
    };
    parse(&format!("{first}) = {length}"), start, usize::MAX)
}

/// A whole call; nothing for signals, ends of threads, and calls that failed.
fn parse(text: &str, start: usize, end: usize) -> Option<Call> {
    if text.starts_with("+++") || text.starts_with("---") {
        return None;
    }
    let (call, result) = text.rsplit_once(" = -").is_none().then(|| text.rsplit_once(" = "))??;
    let result = result.split(' ').next()?.parse().ok()?;
    let (name, arguments) = call.trim_end().strip_suffix(')')?.split_once('(')?;
    let arguments = arguments.split(", ").map(str::to_owned).collect();
    Some(Call { start, end, name: name.to_owned(), arguments, result })
}
