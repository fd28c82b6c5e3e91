//! `kill -9` of the real binary at random moments, again and again on one directory: what was acknowledged is served by
//! the next process.
//!
//! `UBBMAP_KILL_ROUNDS` says how often (10).

use crate::cli_support::{Server, ubbmap};
use crate::crash_client::{Client, number};
use crate::crash_support::{Course, compare, courses, find, say, setting};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;
use ubbmap::store::{MapStore, SledOptions, SledStore};

const ROBOTS: usize = 4;

/// A robot and its maps, one after the other: when its course is at its end it begins again in a new map.
struct Robot {
    number: usize,
    course: Course,
    generation: u64,
    created: bool,
    acknowledged: u64,
}

impl Robot {
    fn map(&self, generation: u64) -> String {
        format!("hall-{}-{generation}", self.number)
    }

    /// Sends until the server is gone.
    fn drive(&mut self, client: &Client) {
        loop {
            if self.acknowledged == self.course.last() {
                (self.generation, self.created, self.acknowledged) = (self.generation + 1, false, 0);
            }
            let map = self.map(self.generation);
            if !self.created {
                let Some((status, answer)) = client.create(&map, &self.course) else { return };
                assert!(status == 200 || status == 201, "{map}: {answer}");
                self.created = true;
            }
            let request = &self.course.requests[usize::try_from(self.acknowledged).unwrap()];
            let Some((status, answer)) = client.insert(&map, request) else { return };
            assert_eq!((status, number(&answer["revision"])), (200, self.acknowledged + 1), "{map}: {answer}");
            self.acknowledged += 1;
        }
    }

    /// Its maps are there as they were acknowledged, or one request further.
    fn check(&mut self, client: &Client) {
        let map = self.map(self.generation);
        match client.revision(&map) {
            Some(_) => {
                let revision = client.check(&map, &self.course);
                let least = self.acknowledged;
                assert!((least..=least + 1).contains(&revision), "{map}: {revision}, {least} was acknowledged");
                (self.created, self.acknowledged) = (true, revision);
            }
            None => assert!(!self.created, "{map} is gone"),
        }
        if let Some(before) = self.generation.checked_sub(1) {
            assert_eq!(client.check(&self.map(before), &self.course), self.course.last());
        }
    }
}

/// A process that is killed while it starts.
fn kill_while_it_starts(data: &Path, after: Duration) {
    let mut command = ubbmap();
    command.args(["serve", "--log", "error", "--listen", "127.0.0.1:0", "--data"]).arg(data);
    let mut child = command.stdout(Stdio::null()).spawn().unwrap();
    std::thread::sleep(after);
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn what_was_acknowledged_is_served_after_kill_9_at_any_moment() {
    let (rounds, seed) = (setting("UBBMAP_KILL_ROUNDS", 10), setting("UBBMAP_KILL_SEED", 1));
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let courses = courses(seed, ROBOTS, 150).into_iter().enumerate();
    let robot = |(number, course)| Robot { number, course, generation: 0, created: false, acknowledged: 0 };
    let mut robots: Vec<Robot> = courses.map(robot).collect();
    let mut total = 0;
    for _ in 0..rounds {
        if random.random_bool(0.5) {
            kill_while_it_starts(&data, Duration::from_millis(random.random_range(0..120)));
        }
        let mut server = Server::start(&data, "127.0.0.1:0");
        let client = Client::new(&server.url);
        robots.iter_mut().for_each(|robot| robot.check(&client));
        let count = |robots: &[Robot]| {
            robots.iter().map(|robot| robot.generation * robot.course.last() + robot.acknowledged).sum::<u64>()
        };
        let before = count(&robots);
        let moment = Duration::from_millis(random.random_range(5..400));
        std::thread::scope(|scope| {
            for robot in &mut robots {
                let client = client.clone();
                scope.spawn(move || robot.drive(&client));
            }
            std::thread::sleep(moment);
            server.child.kill().unwrap();
        });
        server.child.wait().unwrap();
        total += count(&robots) - before;
    }
    let store = SledStore::open(&data, SledOptions::default()).unwrap();
    for robot in &robots {
        for generation in 0..=robot.generation {
            let Some((id, revision)) = find(&store, &robot.map(generation)) else {
                assert!(generation == robot.generation && !robot.created);
                continue;
            };
            let least = if generation < robot.generation { robot.course.last() } else { robot.acknowledged };
            assert!(revision >= least, "{}: {revision}, {least} was acknowledged", robot.map(generation));
            compare(&store, id, &robot.course.at(revision).unwrap()).unwrap();
        }
    }
    assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
    assert!(store.damaged().is_empty());
    say(&format!("kill -9: {rounds} rounds from seed {seed}, {total} acknowledged requests"));
    assert!(total > 5 * rounds, "{total} requests were acknowledged in {rounds} rounds");
}
