// OctoMap as a peer: times insertion of laser scans into a slice of one voxel, and answers what it says of points.
//
//   octomap_peer SCANS --resolution M [--loops N] [--mode whole|lazy|discrete] [--points FILE --answers FILE] [--bt FILE]
//
// SCANS: one scan a line, `x y n x1 y1 .. xn yn`: the sensor's position and its n returns in the map frame, metres.
// Points: `x y` a line. Answers: the occupancy probability of each, a line, -1 where OctoMap knows nothing.
// Prints one JSON object. Seconds are processor time of insertion alone: clouds are made before, files are read before.
// Probabilities, clamping and threshold are OctoMap's defaults (0.7, 0.4, 0.1192 to 0.971, 0.5).

#include <octomap/octomap.h>

#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

struct Scan {
    octomap::point3d origin;
    octomap::Pointcloud returns;
};

// How a scan is inserted: as the library does it by default, with inner nodes left for one pass at the end of a loop,
// or with the returns of one voxel taken once, too.
enum class Mode { Whole, Lazy, Discrete };

struct Options {
    std::string scans, points, answers, bt;
    double resolution = 0.1;
    long loops = 1;
    Mode mode = Mode::Lazy;
};

Options parse(int argc, char **argv) {
    Options options;
    for (int i = 1; i < argc; ++i) {
        const std::string word = argv[i];
        if (word.rfind("--", 0) != 0) {
            options.scans = word;
            continue;
        }
        if (i + 1 == argc) throw std::runtime_error(word + " wants a value");
        const std::string value = argv[++i];
        if (word == "--resolution") options.resolution = std::stod(value);
        else if (word == "--loops") options.loops = std::stol(value);
        else if (word == "--points") options.points = value;
        else if (word == "--answers") options.answers = value;
        else if (word == "--bt") options.bt = value;
        else if (word == "--mode" && value == "whole") options.mode = Mode::Whole;
        else if (word == "--mode" && value == "lazy") options.mode = Mode::Lazy;
        else if (word == "--mode" && value == "discrete") options.mode = Mode::Discrete;
        else throw std::runtime_error("unknown: " + word + " " + value);
    }
    if (options.scans.empty()) throw std::runtime_error("no scans: see the head of octomap_peer.cpp");
    if (!(options.resolution > 0.0) || options.loops < 1) throw std::runtime_error("resolution and loops are positive");
    return options;
}

std::vector<Scan> read(const std::string &path) {
    std::ifstream file(path);
    if (!file) throw std::runtime_error("cannot open " + path);
    std::vector<Scan> scans;
    for (std::string line; std::getline(file, line);) {
        std::istringstream words(line);
        float x, y;
        std::size_t count;
        if (!(words >> x >> y >> count)) throw std::runtime_error(path + ": not a scan: " + line.substr(0, 40));
        Scan scan{octomap::point3d(x, y, 0.0f), {}};
        scan.returns.reserve(count);
        for (std::size_t i = 0; i < count; ++i) {
            if (!(words >> x >> y)) throw std::runtime_error(path + ": a scan ends early");
            scan.returns.push_back(x, y, 0.0f);
        }
        scans.push_back(std::move(scan));
    }
    return scans;
}

double seconds() {
    timespec time{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
    return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

void insert(octomap::OcTree &tree, const std::vector<Scan> &scans, Mode mode) {
    const bool lazy = mode != Mode::Whole;
    for (const Scan &scan : scans) tree.insertPointCloud(scan.returns, scan.origin, -1.0, lazy, mode == Mode::Discrete);
    if (lazy) tree.updateInnerOccupancy();
}

void answer(const octomap::OcTree &tree, const std::string &points, const std::string &answers) {
    std::ifstream in(points);
    std::ofstream out(answers);
    if (!in || !out) throw std::runtime_error("cannot open " + points + " or " + answers);
    for (double x, y; in >> x >> y;) {
        const octomap::OcTreeNode *node = tree.search(x, y, 0.0);
        out << (node ? node->getOccupancy() : -1.0) << '\n';
    }
    if (!out.flush()) throw std::runtime_error("cannot write " + answers);
}

long long size_of(const std::string &path) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    return file ? static_cast<long long>(file.tellg()) : -1;
}

void run(const Options &options) {
    const std::vector<Scan> scans = read(options.scans);
    octomap::OcTree tree(options.resolution);
    const double start = seconds();
    for (long i = 0; i < options.loops; ++i) insert(tree, scans, options.mode);
    const double spent = seconds() - start;
    if (!options.points.empty()) answer(tree, options.points, options.answers);
    tree.prune();
    const unsigned long long memory = tree.memoryUsage();
    const unsigned long long leaves = tree.getNumLeafNodes();
    long long bytes = -1;
    if (!options.bt.empty()) {
        if (!tree.writeBinary(options.bt)) throw std::runtime_error("cannot write " + options.bt);
        bytes = size_of(options.bt);
    }
    const double count = static_cast<double>(scans.size()) * static_cast<double>(options.loops);
    std::printf("{\"version\":\"%s\",\"scans\":%.0f,\"seconds\":%.6f,\"scans_per_second\":%.1f,\"leaves\":%llu,"
                "\"memory_bytes\":%llu,\"bt_bytes\":%lld}\n",
                OCTOMAP_PEER_VERSION, count, spent, count / spent, leaves, memory, bytes);
}

}  // namespace

int main(int argc, char **argv) {
    try {
        run(parse(argc, argv));
        return EXIT_SUCCESS;
    } catch (const std::exception &error) {
        std::cerr << "octomap_peer: " << error.what() << '\n';
        return EXIT_FAILURE;
    }
}
