//! A `.db3` file: the SQLite database of an older ROS 2 bag.

use super::file::{LONGEST_RECORD, MOST_TOPICS, Message, Topic};
use super::messages::Kind;
use rusqlite::limits::Limit;
use rusqlite::{Connection, OpenFlags};
use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Messages are fetched until so many bytes of them are in memory.
const BYTES_AT_ONCE: usize = 4 << 20;

/// Most steps of SQLite for each byte of a file, and beside them: a message takes a few dozen, and tens of bytes at least. Pages
/// that name each other in a damaged file make rows without end.
const STEPS_PER_BYTE: u64 = 16;
const LEAST_STEPS: u64 = 16 << 20;

/// Steps between two looks at how many there were.
const STEPS_AT_ONCE: i32 = 10_000;

/// A database that is being read.
pub(super) struct SqliteFile {
    database: Connection,
    topics: HashMap<i64, (Arc<Topic>, Option<Kind>)>,
    /// The topics that are read, as the list of a query.
    wanted: String,
    /// The number of the last message that was fetched.
    last: i64,
    /// How many bytes of messages may still come: all of them stand in the file.
    left: u64,
    fetched: VecDeque<Message>,
    count: Arc<AtomicU64>,
}

impl SqliteFile {
    pub(super) fn open(path: &Path, count: Arc<AtomicU64>) -> Result<Self, String> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let mut database = Connection::open_with_flags(path, flags).map_err(|error| told(&error))?;
        let bytes = bytes_of(path).map_err(|error| error.to_string())?;
        limit_steps(&mut database, bytes).map_err(|error| told(&error))?;
        let topics = prepare(&database).map_err(|error| told(&error))??;
        let wanted: Vec<String> =
            topics.iter().filter(|(_, (_, kind))| kind.is_some()).map(|(id, _)| id.to_string()).collect();
        Ok(Self {
            database,
            topics,
            wanted: wanted.join(","),
            last: i64::MIN,
            left: bytes,
            fetched: VecDeque::new(),
            count,
        })
    }

    pub(super) fn topics(&self) -> Vec<Arc<Topic>> {
        self.topics.values().map(|(topic, _)| Arc::clone(topic)).collect()
    }

    pub(super) fn next_message(&mut self) -> Result<Option<Message>, String> {
        if self.fetched.is_empty() {
            self.fetch().map_err(|error| told(&error))??;
        }
        Ok(self.fetched.pop_front())
    }

    fn fetch(&mut self) -> rusqlite::Result<Result<(), String>> {
        // By the number that SQLite keeps itself, which is the column `id` where a recorder wrote the file: rows come as they lie
        // and are never sorted in memory.
        let query = format!(
            "SELECT rowid, topic_id, data FROM messages WHERE rowid > ?1 AND topic_id IN ({}) ORDER BY rowid",
            self.wanted
        );
        let mut statement = self.database.prepare(&query)?;
        let mut rows = statement.query([self.last])?;
        let mut bytes = 0;
        while bytes < BYTES_AT_ONCE {
            let Some(row) = rows.next()? else { return Ok(Ok(())) };
            let number = row.get(0)?;
            if number <= self.last {
                let last = self.last;
                return Ok(Err(format!(
                    "the SQLite database is damaged: message {number} stands behind message {last}"
                )));
            }
            self.last = number;
            let topic: i64 = row.get(1)?;
            let data = row.get_ref(2)?.as_blob()?;
            bytes += data.len();
            let Some(left) = self.left.checked_sub(data.len() as u64) else {
                return Ok(Err("the SQLite database is damaged: it holds more messages than it has bytes".to_owned()));
            };
            self.left = left;
            self.count.fetch_add(data.len() as u64, Ordering::Relaxed);
            if let Some((topic, Some(kind))) = self.topics.get(&topic) {
                self.fetched.push_back(Message { topic: Arc::clone(topic), kind: *kind, data: data.to_vec() });
            }
        }
        Ok(Ok(()))
    }
}

/// The bytes of a database: of the file, and of the log beside it, which a recorder that was killed leaves.
fn bytes_of(path: &Path) -> std::io::Result<u64> {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    let log = std::fs::metadata(log).map_or(0, |log| log.len());
    Ok(std::fs::metadata(path)?.len().saturating_add(log))
}

/// Ends the reading of a file that takes more steps than its bytes can be worth.
fn limit_steps(database: &mut Connection, bytes: u64) -> rusqlite::Result<()> {
    let mut left = bytes.saturating_mul(STEPS_PER_BYTE).saturating_add(LEAST_STEPS);
    let spent = move || {
        left = left.saturating_sub(u64::from(STEPS_AT_ONCE.unsigned_abs()));
        left == 0
    };
    database.progress_handler(STEPS_AT_ONCE, Some(spent))
}

/// Topics by their number in the database, and what those are whose messages are read.
type Topics = HashMap<i64, (Arc<Topic>, Option<Kind>)>;

/// Guards against what a database may hold to harm its reader, and reads the topics.
fn prepare(database: &Connection) -> rusqlite::Result<Result<Topics, String>> {
    let longest = i32::try_from(LONGEST_RECORD).unwrap_or(i32::MAX);
    database.set_limit(Limit::SQLITE_LIMIT_LENGTH, longest)?;
    // No attached files, and no views or functions that the file itself brings.
    database.set_limit(Limit::SQLITE_LIMIT_ATTACHED, 0)?;
    database.execute_batch("PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON; PRAGMA mmap_size = 0;")?;
    for table in ["topics", "messages"] {
        let kind =
            "SELECT count(*) FROM sqlite_master WHERE name = ?1 AND type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%'";
        let found: i64 = database.query_row(kind, [table], |row| row.get(0))?;
        if found != 1 {
            return Ok(Err(format!("is a SQLite database without a table {table:?}: no ROS 2 bag")));
        }
    }
    let mut statement = database.prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id")?;
    let mut rows = statement.query([])?;
    let mut topics = HashMap::new();
    while let Some(row) = rows.next()? {
        if topics.len() >= MOST_TOPICS {
            return Ok(Err(format!("has more than {MOST_TOPICS} topics")));
        }
        let topic = Topic::new(row.get_ref(1)?.as_str()?, row.get_ref(2)?.as_str()?, row.get_ref(3)?.as_str()?);
        let kind = topic.kind;
        topics.insert(row.get(0)?, (Arc::new(topic), kind));
    }
    Ok(Ok(topics))
}

fn told(error: &rusqlite::Error) -> String {
    if error.sqlite_error_code() == Some(rusqlite::ErrorCode::OperationInterrupted) {
        return "the SQLite database is damaged: reading it takes more steps than a file of its size can need"
            .to_owned();
    }
    format!("the SQLite database cannot be read: {error}")
}
