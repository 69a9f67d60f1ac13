// Checks a model in C++ against its test vectors: check MODEL.onnx FOLDER
#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <stdexcept>

#include "denoiser.hpp"

namespace {

using Json = nlohmann::json;
using Path = std::filesystem::path;

nte::Tensors read(const Path& folder, const Json& listed) {
    nte::Tensors tensors;
    for (const auto& [name, entry] : listed.items()) {
        const auto file = folder / entry.at("file").get<std::string>();
        std::vector<float> values(std::filesystem::file_size(file) / sizeof(float));
        std::ifstream stream(file, std::ios::binary);
        // The files are little-endian, as the machines that this runs on.
        if (!stream.read(reinterpret_cast<char*>(values.data()), static_cast<std::streamsize>(values.size() * sizeof(float))))
            throw std::runtime_error(file.string() + ": cannot be read");
        tensors[name] = {entry.at("shape").get<std::vector<std::int64_t>>(), std::move(values)};
    }
    return tensors;
}

// The largest |a − b| / (|b| + 0.01); infinite where an a is no number.
double difference(const std::vector<float>& found, const std::vector<float>& expected) {
    constexpr double infinite = std::numeric_limits<double>::infinity();
    if (found.size() != expected.size()) return infinite;
    double worst = 0;
    for (std::size_t i = 0; i < found.size(); ++i) {
        const double relative = std::abs(double{found[i]} - expected[i]) / (std::abs(double{expected[i]}) + 0.01);
        if (!(relative <= worst)) worst = std::isnan(relative) ? infinite : relative;
    }
    return worst;
}

// Runs one way of denoising over all frames, and tells whether it stays within the tolerance.
bool agrees(const char* way, const Path& folder, const Json& index, const std::function<nte::Tensors(nte::Tensors)>& denoise) {
    double worst = 0;
    std::string where = "all are equal";
    std::size_t number = 0;
    for (const auto& frame : index.at("frames")) {
        const auto made = denoise(read(folder, frame.at("inputs")));
        for (const auto& [name, expected] : read(folder, frame.at("outputs"))) {
            const double found = difference(made.at(name).values, expected.values);
            if (found > worst) worst = found, where = name + " of frame " + std::to_string(number);
        }
        ++number;
    }
    std::printf("%s: %zu frames, largest difference %.1e (%s)\n", way, number, worst, where.c_str());
    const double tolerance = index.at("tolerance").get<double>();
    if (worst <= tolerance) return true;
    std::printf("more than %g\n", tolerance);
    return false;
}

}  // namespace

int main(int count, char** arguments) {
    if (count != 3) {
        std::fputs("usage: check MODEL.onnx FOLDER\n", stderr);
        return 2;
    }
    try {
        const Path folder = arguments[2];
        std::ifstream stream(folder / "vectors.json");
        if (!stream) throw std::runtime_error((folder / "vectors.json").string() + ": cannot be read");
        const Json index = Json::parse(stream);
        nte::Denoiser denoiser(arguments[1]);
        const auto& every = denoiser.outputs();
        const bool given = agrees("with the state of the files", folder, index,
                                  [&](const nte::Tensors& inputs) { return denoiser.run(inputs, every); });
        const bool kept = agrees("with the state it keeps", folder, index,
                                 [&](const nte::Tensors& inputs) { return denoiser.denoise(inputs, every); });
        return given && kept ? 0 : 1;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 2;
    }
}
